"""Load errors: masses that are not as stated, against Pinocchio and differences of whole models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_slopes import LoadSlopes, with_masses, with_payload
from kilter_core.arm.load_wrenches import axial_loads, row_load_wrenches
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.effects import EFFECTS as KNOWN
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.truth import Arm, some_arm, with_bodies
from tests.corrector.test_runtime_effects import robot_for

KATANA = robot_from_document(preset_document("katana450-chapter5"))
EFFECTS = ("axial_compliance", "radial_compliance", "link_bending", "base_compliance", "tool_sag")


def other_masses(n: int, dynamic: bool) -> tuple[Arm, Robot, Observations, np.ndarray]:
    """An arm, the robot its user believes in, rows, and the load errors between the two."""
    rng = np.random.default_rng(n)
    arm = replace(with_bodies(some_arm(rng, n), rng), base=pin.SE3.Identity())
    true = robot_from_document(arm.document())
    links = tuple(
        replace(link, mass=1.15 * link.mass, com=link.com + rng.uniform(-0.01, 0.01, 3)) for link in true.links
    )
    q = rng.uniform(-2.0, 2.0, (8, n))
    motion = {"qd": rng.normal(size=q.shape), "qdd": rng.normal(size=q.shape)} if dynamic else {}
    wrong = replace(true, links=links)
    errors = [
        (t.mass - w.mass, *(t.mass * (t.com - w.com))) for t, w in zip(true.links, wrong.links, strict=True)
    ]  # mass at the stated centre, then first moment beyond
    return arm, wrong, Observations(q, **motion), np.array(errors).ravel()


@pytest.mark.parametrize("n", [3, 6, 7])
def test_static_loads_with_load_errors_are_those_of_the_true_masses(n: int) -> None:
    arm, wrong, rows, errors = other_masses(n, dynamic=False)
    model = RobotModel(wrong, (make_effect("load_error"),))
    batch = model.batch(rows)
    right = model.apply_load_errors(batch, np.concatenate([model.values0()[: model.n_geometric], errors]))
    for k in range(len(rows)):
        torques, wrenches, root = arm.reactions(rows.q[k])
        np.testing.assert_allclose(right.axial[k], -torques, atol=1e-10, rtol=0)
        np.testing.assert_allclose(right.wrench[k], -wrenches, atol=1e-10, rtol=0)
        np.testing.assert_allclose(right.base_wrench[k], -root, atol=1e-10, rtol=0)
    assert np.max(np.abs(batch.axial - right.axial)) > 0.1


@pytest.mark.parametrize("dynamic", [False, True])
def test_a_robot_with_the_masses_has_the_loads_of_the_slopes(dynamic: bool) -> None:
    _, wrong, rows, errors = other_masses(6, dynamic)
    slopes = LoadSlopes(wrong, rows)
    once, anew = row_load_wrenches(wrong, rows), row_load_wrenches(with_masses(wrong, errors), rows)
    linear = axial_loads(wrong, once) + np.tensordot(errors, slopes.component_slopes("axial", 0), axes=1)
    np.testing.assert_allclose(axial_loads(wrong, anew), linear, atol=1e-10, rtol=0)
    for name, before, after in (
        ("wrench", once.joints, anew.joints), ("end_wrench", once.ends, anew.ends), ("base_wrench", once.base, anew.base),
    ):  # fmt: skip
        for part in range(6):
            moved = np.tensordot(errors, slopes.component_slopes(name, part), axes=1)
            np.testing.assert_allclose(before[..., part] + moved, after[..., part], atol=1e-9, rtol=0)


@pytest.mark.parametrize("dynamic", [False, True])
@pytest.mark.parametrize("kind", [{}, {"prismatic": True}, {"coupled": True}])
def test_changes_of_loads_are_those_of_other_masses_and_another_payload(kind: dict[str, bool], dynamic: bool) -> None:
    """Made at once, from slopes that a derivative left, and of a part of the rows."""
    rng = np.random.default_rng(3)
    robot = robot_from_document(with_bodies(some_arm(rng, 5, **kind), rng, followers=True).document())
    q, kg, place = rng.uniform(-2.0, 2.0, (9, 5)), rng.choice([0.0, 2.0], 9), rng.normal(0.0, 0.1, (9, 3))
    motion = {"qd": rng.normal(size=q.shape), "qdd": rng.normal(size=q.shape)} if dynamic else {}
    rows = Observations(q, payload_kg=kg, payload_com=place, **motion)
    slopes = LoadSlopes(robot, rows)
    errors = rng.normal(0.0, 1e-3, len(slopes))
    laden = [with_payload(m, c, errors[-4:]) for m, c in zip(kg, place, strict=True)]
    other = replace(rows, payload_kg=np.array([m for m, _ in laden]), payload_com=np.array([c for _, c in laden]))
    once, anew = row_load_wrenches(robot, rows), row_load_wrenches(with_masses(robot, errors[:-4]), other)
    truth = {
        "axial": (axial_loads(robot, anew) - axial_loads(robot, once))[..., None], "wrench": anew.joints - once.joints,
        "end_wrench": anew.ends - once.ends, "base_wrench": anew.base - once.base,
    }  # fmt: skip
    for again in range(2):
        for name, moved in truth.items():
            parts = tuple(range(moved.shape[-1]))
            found = (slopes.changes(name, parts, errors), slopes.select_rows(slice(2, 6)).changes(name, parts, errors))
            # A dynamic load is quadratic in a place: products of two errors are left out.
            np.testing.assert_allclose(np.moveaxis(found[0], 0, -1), moved, rtol=0, atol=1e-3 if dynamic else 1e-10)
            assert np.abs(moved).max() > 0.01
            np.testing.assert_allclose(np.moveaxis(found[1], 0, -1), np.moveaxis(found[0], 0, -1)[2:6], atol=1e-12)
            if again == 0:
                slopes.component_slopes(name, parts[-1])


def test_slopes_that_nobody_reads_are_not_made() -> None:
    """All of them took 20 kB a row."""
    found = loaded_calibration("axial_compliance")
    model, batch = found.model, found.model.batch(rows_of(KATANA, 30))
    assert batch.slopes is not None
    model.predict(batch, found.values)
    assert not batch.slopes._made
    model.jacobian(batch, found.values)
    assert [name for name, _ in batch.slopes._made] == ["axial"]


@pytest.mark.parametrize("effect", sorted(k for k, e in KNOWN.items() if "moments" in e.needs and not e.nuisance))
def test_an_effect_reads_no_load_that_it_does_not_name(effect: str) -> None:
    """In a fit only those follow the masses."""
    robot = robot_for([effect]) if effect == "telescope_bending" else KATANA
    found = loaded_calibration(effect, robot=robot)
    sides = np.random.default_rng(0).choice([-1.0, 1.0], (30, robot.n_joints))
    rows = replace(rows_of(robot, 30), direction=sides)
    batch, (own, errors) = found.model.batch(rows), found.model.effect_slices().values()
    made = found.model.effects[0]
    loaded = (batch.with_loads(found.values[errors], reads) for reads in (dict(made.reads) or None, None))
    some, every = (made.local(one, found.values[own]) for one in loaded)
    for name in ("dq", "xi", "base", "tool"):
        one, other = getattr(some, name), getattr(every, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(one, other)


def test_of_a_batch_only_effects_with_values_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hunt predicts with hundreds of effects, of which a few have values."""
    model = RobotModel(KATANA, (make_effect("eccentricity"), make_effect("axial_compliance")))
    asked = []
    for kind in {type(e) for e in model.effects}:
        local = kind.local
        monkeypatch.setattr(kind, "local", lambda self, *a, local=local: asked.append(self.id) or local(self, *a))
    values = model.values0()
    values[model.effect_slices()["axial_compliance"]] = 1e-5
    rows = rows_of(KATANA, 10)
    of_rows = model.predict(rows, values).position
    assert sorted(asked) == ["axial_compliance", "eccentricity"]
    asked.clear()
    assert np.array_equal(model.predict(model.batch(rows), values).position, of_rows)
    assert asked == ["axial_compliance"]


def rows_of(robot: Robot, count: int, payload: bool = True) -> Observations:
    rng = np.random.default_rng(3)
    low, high = np.clip(robot.limits.T, -2.0, 2.0)
    q = rng.uniform(low, high, (count, robot.n_joints))
    kg = rng.choice([0.0, 2.0], count) if payload else None
    return Observations(q, payload_kg=kg, payload_com=None if kg is None else rng.normal(0.0, 0.02, (count, 3)))


def loaded_calibration(*effects: str, payload: bool = True, robot: Robot = KATANA, **options: object) -> Calibration:
    """An arm with these effects and load errors, all with values of about a prior width."""
    rows = rows_of(robot, 30, payload)
    made = [make_effect(e, **options.get(e, {})).configure_for_robot(robot, rows) for e in (*effects, "load_error")]  # type: ignore[attr-defined]
    model, rng = RobotModel(robot, tuple(made)), np.random.default_rng(1)
    values = model.values0()
    for k in range(model.n_geometric, len(values)):
        p = model.parameters[k]
        values[k] = p.prior_sigma * (rng.normal() if p.lower < 0.0 else rng.uniform(0.3, 1.0))
    return Calibration(model, values)


SOFT = {"backlash_load": {"softening_nm": 0.3}, "clearance_tilt": {"softening_nm": (0.2,) * 5}}


@pytest.mark.parametrize("effect", [*EFFECTS, *SOFT])
def test_the_jacobian_by_load_errors_is_the_central_difference(effect: str) -> None:
    found = loaded_calibration(effect, **SOFT)
    model, rows = found.model, rows_of(KATANA, 30)
    batch = model.batch(rows)
    own = model.effect_slices()["load_error"]
    J = model.jacobian(batch, found.values)[1][:, :3, own]
    assert np.any(J)
    for k in range(own.start, own.stop):
        step = np.zeros_like(found.values)
        step[k] = 1e-4 * model.parameters[k].prior_sigma
        ahead, behind = (model.predict(batch, found.values + way * step).position for way in (1, -1))
        column = J[:, :, k - own.start]
        np.testing.assert_allclose(column, (ahead - behind) / (2 * step[k]), rtol=2e-4, atol=1e-3 * np.abs(J).max())


def test_load_errors_alone_move_nothing() -> None:
    found = loaded_calibration()
    rows = rows_of(KATANA, 10)
    plain = Calibration.nominal(KATANA).predict(rows).position
    assert np.array_equal(found.predict(rows).position, plain)
    assert not np.any(found.model.jacobian(rows, found.values)[1][:, :, found.model.n_geometric :])


@pytest.mark.parametrize("payload_kg", [0.0, 0.7])
@pytest.mark.parametrize("payload", [(), ("payload_error",)])
def test_the_corrector_carries_the_masses(payload_kg: float, payload: tuple[str, ...]) -> None:
    """The tool lands where the whole model, with the masses of the version, says that it should."""
    found = loaded_calibration("axial_compliance", "link_bending", "clearance_tilt", "backlash_load", *payload, **SOFT)
    rng = np.random.default_rng(8)
    q = rng.uniform(*(0.4 * np.clip(KATANA.limits.T, -1.5, 1.5)), (40, KATANA.n_joints))
    options = CorrectionOptions(least_softening_nm=0.0, iterations=30, payload_kg=payload_kg)
    program = compile_program(found, options)
    assert not program.unsupported
    result = program.correct_rows(q)
    good = (result.flags == 0) & (result.limit_mask == 0)
    assert good.mean() > 0.5
    carried = np.full(len(q), payload_kg)
    actual = found.predict(Observations(result.q, payload_kg=carried)).position
    wanted = found.nominal_in_wanted_frames().predict(Observations(q)).position
    assert np.max(np.linalg.norm(actual - wanted, axis=1)[good]) < 5e-6
    stated = found.values.copy()
    stated[found.model.effect_slices()["load_error"]] = 0.0
    elsewhere = compile_program(replace(found, values=stated), options).correct_rows(q).q
    assert np.max(np.abs(elsewhere - result.q)) > 1e-5


def test_blurred_signs_are_the_expectation_and_leave_its_scatter() -> None:
    model = RobotModel(KATANA, (make_effect("backlash_load", [1]),))
    rows = rows_of(KATANA, 200, payload=False)
    values = np.append(model.values0()[: model.n_geometric], 1e-3)
    batch = model.batch(rows)
    wide = float(np.median(np.abs(batch.axial[:, 1])))
    soft = replace(batch, blur=np.full((5, 2), wide))
    expected = model.effects[0].local(soft, values[-1:]).dq[:, 1] / 1e-3  # type: ignore[index]
    drawn = np.random.default_rng(0).normal(batch.axial[:, 1], wide, (4000, 200))
    np.testing.assert_allclose(expected, np.sign(drawn).mean(axis=0), atol=0.06)
    (scatter,) = model.effects[0].doubt(soft, values[-1:])
    assert scatter.dq is not None
    np.testing.assert_allclose(scatter.dq**2, 1e-6 * (1.0 - expected**2), atol=1e-15)
    assert model.doubts(batch, values)[1].max() == 0.0
    kept = replace(model, effects=(model.effects[0].with_softened_signs(soft),))
    np.testing.assert_allclose(kept.predict(batch, values).position, model.predict(soft, values).position, atol=1e-15)


def test_priors_are_those_of_the_robot() -> None:
    document = preset_document("katana450-chapter5")
    links = [{**link, "mass_sigma_kg": 0.2, "com_sigma_mm": 3.0} for link in document["links"]]
    told = robot_from_document({**document, "links": links, "payload_sigma": {"mass_percent": 5.0, "com_mm": 2.0}})
    rows = rows_of(told, 20)
    found = {p.name: p.prior_sigma for p in make_effect("load_error").configure_for_robot(told, rows).parameters(told)}
    usual = {
        p.name: p.prior_sigma for p in make_effect("load_error").configure_for_robot(KATANA, rows).parameters(KATANA)
    }
    heavy = next(k for k, link in enumerate(told.links) if link.mass > 0)
    mass = told.links[heavy].mass
    assert found[f"link_mass_{heavy + 1}"] == pytest.approx(0.2)
    assert found[f"link_moment_x_{heavy + 1}"] == pytest.approx(0.003 * mass)
    assert found["load_payload_mass"] == pytest.approx(0.1)
    assert found["load_payload_x"] == pytest.approx(0.002)
    assert usual[f"link_mass_{heavy + 1}"] == pytest.approx(0.1 * mass)
    assert usual[f"link_moment_x_{heavy + 1}"] == pytest.approx(0.01 * mass)
    assert usual["load_payload_mass"] == pytest.approx(0.2)


def test_every_effect_of_loads_says_which_it_reads() -> None:
    """Else errors of the masses would pass it by. What sags with the payload alone reads its force at the tool."""
    reading = {name for name, kind in KNOWN.items() if "moments" in kind.needs and not kind.changes_loads}
    assert {name for name in reading if not KNOWN[name].reads} <= {"tool_sag"}
