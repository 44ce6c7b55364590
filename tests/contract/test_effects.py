"""Every effect of the registry keeps the contract of ``kilter_core.effects.base.Effect``.

On an odd arm, which has every kind of joint and axis; laws that hang on the loads or on the convention of the geometry
also on a standard one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.effects import BASE, EFFECTS, TOOL, Batch, Effect, Local, effect_from_document, make_effect
from kilter_core.errors import ObservationError, OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.observations import Observations
from kilter_core.transforms import rotation_log
from kilter_files.look.summaries import below_zero
from tests.core.correct.reference import CorrectOptions, correct

Floats = NDArray[np.float64]

# What an effect cannot guess; an effect that is not named here must work without any option.
OPTIONS: Mapping[str, list[dict[str, Any]]] = {
    "clearance_tilt": [{}, {"share": "vector", "softening_nm": 0.1}],
    "backlash_load": [{}, {"joints": (1, 3), "softening_nm": 0.2}],
    "gear_error": [{"joints": (0, 3), "ratios": (101.0, 50.0)}],
    "joint_coupling": [{}, {"joints": (4, 1), "drivers": (3, 2)}],
    "gravity_spring": [{}, {"arms_m": (0.3, 0.2), "angle_rad": 0.4, "free_length_m": 0.1}],
    "payload_error": [{"compliances": (1e-4, 2e-4, 1e-5, 3e-4, 4e-4)}],
    "unknown_joint_curve": [{}, {"joints": (1,), "orders": (), "partner": 3}],
    "unknown_field": [{}, {"degree": 3, "reach_m": 0.7}],
    "unknown_residual": [{}, {"inputs": (2, 1), "length": 0.8, "amplitude_m": 1e-3}],
}

SLIDES = ("straightness", "guide_rotation", "telescope_bending")  # act at prismatic joints alone

# Axes about x and y, a joint turned round, a slide along x, gears at three joints: what a standard arm never shows.
ODD_ARM = {
    "name": "odd",
    "convention": "chain",
    "joints": [
        {"name": "a", "limits_deg": [-120, 120], "gear_ratio": 101},
        {"name": "b", "limits_deg": [-120, 120], "gear_ratio": 80.5},
        {"name": "c", "limits_mm": [-100, 200]},
        {"name": "d", "limits_deg": [-170, 170], "gear_ratio": 50},
        {"name": "e", "limits_deg": [-170, 170]},
    ],
    "elements": [
        {"axis": "Tz", "value": 300},
        {"axis": "Ry", "joint": "a", "value": 5},
        {"axis": "Tx", "value": 250},
        {"axis": "Rx", "joint": "b", "ratio": -1},
        {"axis": "Ry", "value": 30},
        {"axis": "Tz", "value": 200},
        {"axis": "Tx", "joint": "c", "value": 100},
        {"axis": "Ty", "value": 120},
        {"axis": "Rz", "joint": "d"},
        {"axis": "Rx", "value": 40},
        {"axis": "Tx", "value": 150},
        {"axis": "Rx", "joint": "e", "ratio": -1},
        {"axis": "Tz", "value": 80},
    ],
    "links": [
        {"mass_kg": 5, "com_mm": [100, 0, 10], "inertia_kg_m2": [0.02, 0.03, 0.04, 0, 0, 0.001]},
        {"mass_kg": 4, "com_mm": [0, 20, 90], "inertia_kg_m2": [0.02, 0.02, 0.01, 0.001, 0, 0]},
        {"mass_kg": 3, "com_mm": [10, 60, 0]},
        {"mass_kg": 2, "com_mm": [70, 0, 5]},
        {"mass_kg": 1, "com_mm": [0, 0, 40]},
    ],
    "base": {"x_mm": 100, "y_mm": -50, "z_mm": 20, "rx_deg": 2, "ry_deg": -3, "rz_deg": 30},
    "tool": {"x_mm": 20, "y_mm": 30, "z_mm": 100, "rx_deg": 10, "ry_deg": 20, "rz_deg": -15},
}

# As many joints as a pose has numbers: then one answer corrects a pose, however it is reached.
SIX_JOINTS = {
    **ODD_ARM,
    "joints": [*ODD_ARM["joints"], {"name": "f", "limits_deg": [-170, 170]}],
    "elements": [*ODD_ARM["elements"], {"axis": "Ry", "joint": "f"}, {"axis": "Tx", "value": 60}],
    "links": [*ODD_ARM["links"], {"mass_kg": 0.5, "com_mm": [30, 10, 0]}],
}
ARMS: Mapping[str, Any] = {"odd": ODD_ARM, "six": SIX_JOINTS}

READ_BY = {
    "moments": {"wrench", "axial", "end_wrench", "base_wrench", "blur", "centre_wrench", "centre_axial"},
    "payload_kg": {"payload_kg", "payload_axial"},
}
ALWAYS = {"q", "tool_point", "link_vectors"}
PARTS = ("dq", "xi", "base", "tool", "scale")


@cache
def robot_named(name: str) -> Robot:
    return robot_from_document(ARMS[name] if name in ARMS else preset_document(name))


def observed(robot: Robot, count: int, seed: int = 1) -> Observations:
    """Rows with every condition there is, and nothing measured."""
    rng = np.random.default_rng(seed)
    low, high = robot.limits.T
    return Observations(
        q=rng.uniform(low, high, (count, robot.n_joints)),
        direction=rng.choice([-1.0, 1.0], (count, robot.n_joints)),
        qd=rng.normal(0.0, 0.5, (count, robot.n_joints)),
        qdd=rng.normal(0.0, 1.0, (count, robot.n_joints)),
        t=5000.0 + 20.0 * np.arange(count),
        payload_kg=rng.choice([0.0, 2.0], count),
        payload_com=rng.normal(0.0, 0.03, (count, 3)),
        temperature_c=rng.uniform(18.0, 35.0, count),
        session=rng.choice([3, 4, 7], count),
        row=np.arange(1, count + 1),
        base_tilt_x=rng.normal(0.0, 1e-3, count),
        base_tilt_y=rng.normal(0.0, 1e-3, count),
    )


@dataclass(frozen=True)
class Case:
    """One effect on one arm, completed from the arm and its rows."""

    effect: Effect
    robot: Robot
    rows: Observations

    @property
    def model(self) -> RobotModel:
        return RobotModel(self.robot, (self.effect,))

    def batch(self, rows: Observations | None = None) -> Batch:
        return self.model.batch(self.rows if rows is None else rows)

    def values(self) -> Floats:
        """Values of a plausible size, of the sign that physics asks for."""
        rng = np.random.default_rng(2)
        sigma = np.array([p.prior_sigma for p in self.effect.parameters(self.robot)])
        sign = 1.0 if self.effect.signs == "positive" else rng.choice([-1.0, 1.0], len(sigma))
        return sigma * sign * rng.uniform(0.3, 1.0, len(sigma))

    def whole(self, values: Floats) -> Floats:
        """Values of the model: nominal geometry, then these."""
        model = self.model
        return np.concatenate([model.values0()[: model.n_geometric], values])


def cases(*arms: str) -> list[Any]:
    return [
        pytest.param((name, options, arm), id=f"{name}{k or ''}-{arm}")
        for name in EFFECTS
        for k, options in enumerate(OPTIONS.get(name, [{}]))
        for arm in arms
        if arm == "odd" or name not in SLIDES
    ]


# For laws that hang on the loads or on the convention of the geometry.
on_each_arm = pytest.mark.parametrize("case", cases("katana450-chapter5", "odd"), indirect=True)


@pytest.fixture(params=cases("odd"))
def case(request: pytest.FixtureRequest) -> Case:
    name, options, arm = request.param
    robot = robot_named(arm)
    rows = observed(robot, 12)
    return Case(make_effect(name, **options).configure_for_robot(robot, rows), robot, rows)


def part(local: Local, name: str, batch: Batch) -> Floats:
    """One kind of correction, zero where the effect has none."""
    rows, n = batch.q.shape
    shape = {"dq": (rows, n), "xi": (rows, n, 6), "base": (rows, 6), "tool": (rows, 6), "scale": (rows,)}[name]
    found = getattr(local, name)
    assert found is None or found.shape == shape, name
    return np.zeros(shape) if found is None else found


def slopes(local: Local, batch: Batch, parameter: int) -> dict[str, Floats]:
    """Derivative of every kind of correction by one parameter, from the effect's sparse list."""
    out = {name: np.zeros_like(part(local, name, batch)) for name in PARTS}
    for d in local.derivatives:
        if d.parameter != parameter:
            continue
        if d.dq is not None:
            out["dq"][:, d.joint] += d.dq
        if d.xi is not None:
            where = {BASE: out["base"], TOOL: out["tool"]}.get(d.joint)
            where = out["xi"][:, d.joint] if where is None else where
            where += d.xi
        if d.scale is not None:
            out["scale"] += d.scale
    return out


def test_every_effect_states_its_physical_class_and_what_names_it_there() -> None:
    for effect in EFFECTS.values():
        robot = robot_named("odd" if effect.id in SLIDES else "katana450-chapter5")
        made = effect(**OPTIONS.get(effect.id, [{}])[0]).configure_for_robot(robot, observed(robot, 12))
        about = made.physical_class(robot)
        assert about.id
        assert "{" not in about.label_for_joints(made.joints)
        # Shapes without a cause, and what nothing but a rival can take away, need no more than their rivals.
        assert about.outside or about.id == "shape", effect.id
        assert len(set(made.separators(robot))) == len(made.separators(robot))


def test_a_slide_keeps_its_scale_and_a_revolute_joint_has_a_smooth_error() -> None:
    robot = robot_named("odd")
    slide, turning = (make_effect("encoder_scale", (j,)).configure_for_robot(robot) for j in (2, 0))
    assert slide.physical_class(robot).label_for_joints((2,)) == "scale of joint 3"
    assert slide.separators(robot) == ()
    assert any("thermal length" in one for one in slide.physical_class(robot).outside)
    assert turning.physical_class(robot).label_for_joints((0,)) == "smooth error of joint 1"
    assert turning.separators(robot)


def test_no_value_no_correction(case: Case) -> None:
    batch, model = case.batch(), case.model
    zero = np.zeros(len(case.effect.parameters(case.robot)))
    local = case.effect.local(batch, zero)
    assert all(not np.any(part(local, name, batch)) for name in PARTS)
    nominal = RobotModel(case.robot).predict(case.rows, RobotModel(case.robot).values0())
    assert np.array_equal(model.predict(batch, model.values0()).position, nominal.position)


def test_shapes_hold_for_any_number_of_rows(case: Case) -> None:
    values = case.values()
    for count in (0, 1, 12):
        batch = case.batch(case.rows.select(slice(0, count)))
        local = case.effect.local(batch, values)
        for name in PARTS:
            assert np.all(np.isfinite(part(local, name, batch)))
        assert {d.parameter for d in local.derivatives} <= set(range(len(values)))
        for d in local.derivatives:
            assert d.dq is None or (d.dq.shape == (count,) and 0 <= d.joint < case.robot.n_joints)
            assert d.xi is None or d.xi.shape == (count, 6)
            assert d.scale is None or d.scale.shape == (count,)
        prediction, J = case.model.jacobian(batch, case.whole(values))
        assert prediction.position.shape == (count, 3)
        assert J.shape == (count, 6, len(case.model.names))


def test_a_row_does_not_depend_on_its_neighbours(case: Case) -> None:
    batch, values = case.batch(), case.values()
    together = case.effect.local(batch, values)
    for k in range(3):
        row = case.batch(case.rows.select(np.array([k])))
        alone = case.effect.local(row, values)
        for name in PARTS:
            np.testing.assert_allclose(
                part(alone, name, row)[0], part(together, name, batch)[k], rtol=1e-13, atol=1e-18
            )


def test_inputs_are_left_alone(case: Case) -> None:
    batch, values = case.batch(), case.values()
    arrays = [a for a in (getattr(batch, f.name) for f in fields(batch)) if isinstance(a, np.ndarray)] + [values]
    for array in arrays:
        array.flags.writeable = False
    before = [a.copy() for a in arrays]
    case.effect.local(batch, values)
    assert all(np.array_equal(a, b) for a, b in zip(arrays, before, strict=True))


@on_each_arm
def test_local_derivative_is_the_central_difference(case: Case) -> None:
    batch, values = case.batch(), case.values()
    local = case.effect.local(batch, values)
    for k in range(len(values)):
        step = np.zeros_like(values)
        step[k] = 0.01 * abs(values[k])
        ahead, behind = (case.effect.local(batch, values + way) for way in (step, -step))
        exact = slopes(local, batch, k)
        for name in PARTS:
            numeric = (part(ahead, name, batch) - part(behind, name, batch)) / (2.0 * step[k])
            largest = float(np.max(np.abs(exact[name]), initial=0.0))
            np.testing.assert_allclose(exact[name], numeric, rtol=1e-6, atol=1e-8 * largest + 1e-12)


def moved(after: Prediction, before: Prediction) -> Floats:
    turn = rotation_log(after.rotation @ before.rotation.transpose(0, 2, 1))
    return np.concatenate([after.position - before.position, turn], axis=1)


@on_each_arm
def test_jacobian_at_the_tool_is_the_central_difference(case: Case) -> None:
    model, batch, whole = case.model, case.batch(), case.whole(case.values())
    _, J = model.jacobian(batch, whole)
    for k in range(model.n_geometric, len(whole)):
        step = np.zeros_like(whole)
        step[k] = 0.1 * abs(whole[k])
        numeric = moved(model.predict(batch, whole + step), model.predict(batch, whole - step)) / (2.0 * step[k])
        largest = float(np.max(np.abs(J[:, :, k])))
        np.testing.assert_allclose(J[:, :, k], numeric, rtol=1e-5, atol=1e-6 * largest + 1e-10)


def test_document_round_trip(case: Case) -> None:
    document = json.loads(json.dumps(case.effect.to_document()))
    again = effect_from_document(document)
    assert again == case.effect
    assert hash(again) == hash(case.effect)
    assert again.configure_for_robot(case.robot, case.rows) == again
    with pytest.raises(OptionError, match="no option"):
        effect_from_document({**document, "colour": "red"})


class Watched(Batch):
    """A batch that refuses to show what the effect did not declare."""

    def __getattribute__(self, name: str) -> Any:
        if name in {f.name for f in fields(Batch)} and name not in super().__getattribute__("__dict__")["allowed"]:
            raise AssertionError(f"reads {name} without declaring it")
        return super().__getattribute__(name)


def test_only_declared_columns_are_read(case: Case) -> None:
    batch, values = case.batch(), case.values()
    allowed = ALWAYS.union(case.effect.glances, *(READ_BY.get(need, {need}) for need in case.effect.needs))
    shown = {f.name: getattr(batch, f.name) for f in fields(batch)}
    watched = Watched(**{name: value if name in allowed else None for name, value in shown.items()})
    watched.__dict__["allowed"] = allowed
    local, open_local = case.effect.local(watched, values), case.effect.local(batch, values)
    assert all(np.array_equal(part(local, name, batch), part(open_local, name, batch)) for name in PARTS)


def test_a_missing_column_is_named(case: Case) -> None:
    for need in case.effect.needs - {"moments"}:
        with pytest.raises(ObservationError, match=need):
            case.effect.local(replace(case.batch(), **{need: None}), case.values())


def test_parameters_are_physical(case: Case) -> None:
    parameters = case.effect.parameters(case.robot)
    assert parameters
    for p in parameters:
        assert p.value == 0.0
        assert 0.0 < p.prior_sigma < np.inf
        assert p.lower < p.upper < np.inf
        assert p.unit
        assert p.description
        assert p.lower >= 0.0 or (case.effect.signs == "any" and p.lower == -p.upper)
        assert below_zero(p.name, -1.0) == (p.lower == 0.0), (
            p.name
        )  # by its name a reader is told what a negative value is


DAMPED, RESIDUAL = 0x0800, 0x1000
TASK = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])  # weights of the rows of a pose, m a radian
CORRECTED: Any = {
    "least_softening_nm": 0.0, "largest_rad": 0.5, "largest_m": 0.3, "farthest_m": 0.5, "iterations": 60, "step": 1e-14,
    "reached_m": 1e-9, "singular_m": 1e-9, "weak_m": 1e-8, "temperature_c": 31.0, "payload_com": (0.01, -0.02, 0.03),
    "base_tilt": (8e-4, -5e-4),
}  # fmt: skip
RUN_TIME_OPTIONS: Mapping[str, list[dict[str, Any]]] = {
    "payload_error": [{"compliances": (1e-4,) * 6}],
    # The first joints carry a load in every pose.
    "clearance_tilt": [{"joints": (0, 1, 2)}, {"joints": (0, 1, 2), "share": "vector", "softening_nm": 0.1}],
}


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
@pytest.mark.parametrize("arm", ["ur10", "six"])
@pytest.mark.parametrize("name", EFFECTS)
def test_what_acts_at_run_time_is_corrected_as_the_reference_does(name: str, arm: str, payload_kg: float) -> None:
    robot = robot_named(arm)
    if arm == "ur10" and name in SLIDES:
        with pytest.raises(OptionError, match="prismatic"):
            make_effect(name).configure_for_robot(robot)
        return
    rows = replace(
        observed(robot, 100, seed=8),
        payload_kg=np.full(100, payload_kg),
        payload_com=np.tile([0.01, -0.02, 0.03], (100, 1)),
        temperature_c=np.full(100, 31.0),
        base_tilt_x=np.full(100, 8e-4),
        base_tilt_y=np.full(100, -5e-4),
    )
    for options in RUN_TIME_OPTIONS.get(name, OPTIONS.get(name, [{}])):
        case = Case(make_effect(name, **options).configure_for_robot(robot, observed(robot, 12)), robot, rows)
        calibration = Calibration(case.model, case.whole(0.1 * case.values()))
        program = compile_program(calibration, CorrectionOptions(**CORRECTED, payload_kg=payload_kg))
        if case.effect.stage == "measurement":
            assert (program.supported, program.unsupported) == ((), ())  # no error of the arm
            continue
        if type(case.effect).at_run_time is Effect.at_run_time or program.unsupported:
            assert (program.supported, program.unsupported) == ((), (name,))
            continue
        motion = {"qd": rows.qd, "qdd": rows.qdd, "direction": rows.direction}
        ours = program.correct_rows(rows.q, **motion)
        theirs = correct(
            calibration, rows.q, **motion, payload_kg=rows.payload_kg, payload_com=rows.payload_com,
            temperature_c=rows.temperature_c, base_tilt=(rows.base_tilt_x, rows.base_tilt_y),
            options=CorrectOptions(max_joint_rad=0.5, max_shift_m=0.5, tolerance_m=1e-13, iterations=60),
        )  # fmt: skip
        good = (theirs.residual < 1e-11) & (theirs.status == 0) & (ours.status == 0)
        good &= (ours.flags & (DAMPED | RESIDUAL)) == 0
        # Near a singularity what is left after the last look at the loads is a larger part of a joint.
        J = calibration.model.joint_jacobian(rows, calibration.values)[1] * TASK[:, None]
        good &= np.linalg.svd(J, compute_uv=False)[:, -1] > 0.05
        if (
            name == "clearance_tilt"
        ):  # where next to no load lies across a joint, its tilt hangs on the correction itself
            good &= np.abs(case.batch().moment[:, :3, :2]).min(axis=(1, 2)) > 0.1
        assert good.sum() > 15
        assert np.abs(ours.q - theirs.q)[good].max() < 1e-9


@on_each_arm
def test_simulated_effect_is_identified(case: Case) -> None:
    """With the geometry known, noise-free poses give the values back, those that move the tool at all."""
    model, rows = case.model, observed(case.robot, 60, seed=5)
    whole = case.whole(case.values())
    truth = model.with_loads_at_values(whole).predict(rows, whole)  # an arm that sags is loaded where it hangs
    measured = replace(rows, position=truth.position, rotation=truth.rotation)
    geometry = tuple(n for n in model.names[: model.n_geometric] if not n.startswith(("base_", "tool_")))
    effects = (case.effect.to_document(),)
    held = {"base": "fixed", "tool": "fixed", "masses": "as_stated"}
    options = IdentifyOptions(effects=effects, fix=geometry, noise_mm=1e-4, **held)
    found = identify(case.robot, measured, options=options).calibration
    moves = np.max(np.abs(model.jacobian(rows, whole)[1]), axis=(0, 1)) > 1e-9
    effect = np.arange(len(whole)) >= model.n_geometric
    np.testing.assert_allclose(found.values[moves & effect], whole[moves & effect], rtol=1e-3)


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=list(EFFECTS))
def test_the_search_for_missing_effects_knows_it(kind: type[Effect]) -> None:
    assert kind.summary
    assert kind.source
    assert kind.remedy
    assert kind.stage in ("joint", "base", "measurement")
    assert kind.signs in ("positive", "any")
    assert kind.id not in kind.aliases
    assert set(kind.aliases) <= set(EFFECTS)
    assert kind.empirical == kind.id.startswith("unknown_")
    if not kind.at_joints:
        with pytest.raises(OptionError, match="leave joints out"):
            make_effect(kind.id, [0], **OPTIONS.get(kind.id, [{}])[0])
    else:
        with pytest.raises(OptionError, match="joint 9"):
            RobotModel(robot_named("odd"), (make_effect(kind.id, [8]),))


@pytest.mark.parametrize("arm", ["katana450-chapter5", "odd"])
def test_all_effects_stand_in_one_model(arm: str) -> None:
    robot = robot_named(arm)
    rows = observed(robot, 5)
    named = [name for name in EFFECTS if arm == "odd" or name not in SLIDES]
    made = (make_effect(name, **OPTIONS.get(name, [{}])[0]).configure_for_robot(robot, rows) for name in named)
    model = RobotModel(robot, tuple(made))
    assert list(model.effect_slices()) == named
    assert np.all(np.isfinite(model.jacobian(rows, model.values0())[1]))


def test_every_effect_has_its_row_in_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/reference/effects.md").read_text(encoding="utf-8")
    missing = [name for name in EFFECTS if f"| `{name}` |" not in page]
    assert not missing
