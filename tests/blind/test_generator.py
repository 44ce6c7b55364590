"""The generator on its own: physics, sizes, noise; and its robots against Kilter's from the document alone."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import joint_loads
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.blind.generator import Case, Hidden, Options, cases, generate, tracker, twin_cases
from tests.blind.generator.arm import Arm, Deflection, built
from tests.blind.generator.arms import ARMS
from tests.blind.generator.background import KINDS as BACKGROUNDS
from tests.blind.generator.campaign import physics_of
from tests.blind.generator.library import LIBRARY
from tests.blind.generator.outside import OUTSIDE
from tests.blind.generator.sizing import Lens, Response, displacement
from tests.blind.generator.twins import TWINS
from tests.blind.generator.visits import plan
from tests.blind.to_core import observations_of, robot_of

GENERATOR = Path(__file__).parent / "generator"
KILTER = {"kilter_core", "kilter_service", "kilter_files", "kilter_client"}
QUIET = Options(range_um=1e-6, range_um_per_m=0.0, angle_urad=1e-6, approach_um=1e-6)
IDENTIFIABLE = {"katana": 23, "elbow": 27, "seven": 31}  # four per joint and three of the tool point


def case(robot: str, *hidden: Hidden, lam: float = 100.0, poses: int = 36, options: Options | None = None) -> Case:
    return Case("test", robot, hidden, (lam,) * len(hidden), poses, options or Options(), "named", 7)


def test_generator_imports_nothing_of_kilter() -> None:
    for path in GENERATOR.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not {n.partition(".")[0] for n in names} & KILTER, path


@pytest.mark.parametrize("name", ARMS)
def test_document_describes_the_drawn_arm(name: str) -> None:
    drawn = ARMS[name]()
    robot = robot_from_document(drawn.document(drawn.mass))
    arm = Arm.nominal(drawn)
    rng = np.random.default_rng(1)
    q = rng.uniform(drawn.limits[:, 0], drawn.limits[:, 1], (20, drawn.n))
    kg = rng.choice([0.0, drawn.payload_kg], 20)
    kilter = Calibration.nominal(robot).predict(Observations(q=q)).position
    model = arm.pinocchio()
    data = model.createData()
    for row, p in zip(q, kilter, strict=True):
        pin.framesForwardKinematics(model, data, row)
        tool = (
            drawn.base_placement[:3, :3] @ data.oMf[model.getFrameId("tool")].translation + drawn.base_placement[:3, 3]
        )
        np.testing.assert_allclose(tool, p, atol=1e-12)
    np.testing.assert_allclose(arm.positions(q), kilter, atol=1e-12)
    loads, load = joint_loads(robot, q, payload_kg=kg), arm.load(q, kg)
    np.testing.assert_allclose(np.concatenate([load.force, load.moment], axis=2), loads.joints, atol=1e-9)
    np.testing.assert_allclose(
        np.concatenate([load.end_force, load.end_moment], axis=2)[:, :-1], loads.ends[:, :-1], atol=1e-9
    )
    np.testing.assert_allclose(load.base, loads.base[:, 3:], atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_kilter_fits_an_arm_without_effects(name: str) -> None:
    campaign = generate(case(name, options=QUIET))
    result = identify(robot_of(campaign), observations_of(campaign.columns), options=IdentifyOptions(level=2))
    assert result.metrics["train"]["registration_only"]["rms_mm"] > 0.1
    assert result.metrics["train"]["identified"]["max_mm"] < 1e-3


@pytest.mark.parametrize(
    "effect",
    ["axial_compliance", "radial_compliance", "link_bending", "base_compliance", "clearance_tilt", "tool_sag"],
)
def test_a_stretched_arm_droops(effect: str) -> None:
    drawn = ARMS["elbow"]()
    arm = Arm.nominal(drawn)
    bent = 50.0 if effect == "tool_sag" else 0.0  # stretched, the tool's own axis is upright
    q = np.radians([[20.0, 90.0, 0.0, 0.0, bent, 0.0]])
    visits = replace(
        plan(arm, 1, Options(revisited=0.0), np.random.default_rng(0)), q=q, load=arm.load(q, np.array([10.0]))
    )
    joints = {"base_compliance": (), "tool_sag": (), "radial_compliance": (0,), "clearance_tilt": (0,)}.get(
        effect, (1,)
    )
    physics = LIBRARY[effect](arm, visits, joints)
    moved = displacement(arm, visits, physics, physics.typical)[0]
    assert moved[2] < -1e-6


def test_a_bent_link_sags_as_a_cantilever() -> None:
    drawn = ARMS["elbow"]()
    arm = Arm.nominal(drawn)
    q = np.radians([[0.0, 90.0, 0.0, 0.0, 0.0, 0.0]])
    visits = replace(
        plan(arm, 1, Options(revisited=0.0), np.random.default_rng(0)), q=q, load=arm.load(q, np.array([10.0]))
    )
    d = Deflection.none(1, arm.n)
    LIBRARY["link_bending"](arm, visits, (1,)).act(np.array([1e-6]), d)
    L, a, own = 0.55, drawn.com[1, 0], 31.0 * 9.80665
    force = 9.80665 * (drawn.mass[2:].sum() + 10.0)
    moment = abs(float(visits.load.end_moment[0, 1, 2]))
    sag = 1e-6 * (force * L**3 / 3 + moment * L**2 / 2 + own * a**2 * (3 * L - a) / 6)
    assert abs(float(d.sag[0, 1, 1])) == pytest.approx(sag, rel=1e-6)


@pytest.mark.parametrize("name", ARMS)
def test_geometry_has_the_freedom_that_theory_says(name: str) -> None:
    rng = np.random.default_rng(3)
    arm = built(ARMS[name](), rng)
    visits = plan(arm, 30, Options(), rng)
    lens = Lens.of(arm, visits, tracker.visit_covariance(arm.positions(visits.q), Options()))
    assert lens.basis.shape[1] == IDENTIFIABLE[name]


ONES = [
    Hidden(h, (2,)) for h in ("clearance_tilt", "backlash", "backlash_load", "axial_compliance", "radial_compliance")
]
ONES += [Hidden(h, (3,)) for h in ("eccentricity", "second_harmonic", "gear_error", "encoder_scale", "friction_windup")]
ONES += [Hidden("link_bending", (1,)), Hidden("joint_coupling", (4, 3)), Hidden("gravity_spring", (1,))]
ONES += [Hidden(h) for h in ("base_compliance", "thermal_growth", "drift", "session_shift", "workspace_field")]
ONES += [Hidden(h, (1,)) for h in ("zero_drift", "zero_thermal", "link_growth", "direction_compliance", "reading_tilt")]
ONES += [Hidden(h) for h in ("settling", "random_walk", "column_bending", "tool_sag")]
ONES += [Hidden(h, (1,)) for h in ("third_harmonic", "hose_torque", "quadratic_curve", "spline_curve", "belt_error")]
ONES += [Hidden("local_bump", (2,)), Hidden("sine_product", (1, 2)), Hidden("stick_slip", (1,))]


@pytest.mark.parametrize("hidden", ONES, ids=lambda h: h.id)
def test_effects_get_the_size_asked_for(hidden: Hidden) -> None:
    options = Options(temperature="cycling", sessions=2)
    truth = generate(case("elbow", hidden, lam=80.0, options=options)).truth.effects[0]
    assert truth.lam == pytest.approx(80.0, rel=0.01)
    assert truth.lam_partial == pytest.approx(truth.lam)
    assert truth.inside == (hidden.id not in OUTSIDE)
    assert 0.0 <= truth.rho <= 1.0 + 1e-9
    assert 1e-3 < truth.rms_mm < 0.5


@pytest.mark.parametrize("name", ARMS)
def test_first_order_response_agrees_with_finite_motions(name: str) -> None:
    rng = np.random.default_rng(5)
    arm = built(ARMS[name](), rng)
    visits = plan(arm, 12, Options(temperature="cycling", sessions=2), rng)
    response = Response.of(arm, visits)
    for effect in LIBRARY:
        hidden = Hidden(
            effect, {"joint_coupling": (3, 2), "gravity_spring": (1,), "hardening": (1, 2)}.get(effect, (0, 1, 2))
        )
        physics = physics_of(hidden, arm, visits, rng)
        d = Deflection.none(len(visits), arm.n)
        physics.act(physics.typical, d)
        finite = displacement(arm, visits, physics, physics.typical)
        np.testing.assert_allclose(response.to(d), finite, atol=2e-3 * np.abs(finite).max())


def test_a_joint_is_asked_for_by_what_it_does_beside_the_others_of_its_family() -> None:
    """Tilts of neighbouring joints imitate each other: alone each does more, and together they do what is asked."""
    truth = generate(case("seven", Hidden("radial_compliance", tuple(range(7))), lam=500.0)).truth.effects[0]
    alone = [
        generate(case("seven", Hidden("radial_compliance", (j,)), lam=truth.joint_lam[j + 1]))
        .truth.effects[0]
        .joint_lam
        for j in range(7)
    ]
    assert sum(truth.joint_lam.values()) < 0.7 * truth.lam
    assert [own[j + 1] for j, own in enumerate(alone)] == pytest.approx(list(truth.joint_lam.values()), rel=0.05)


def test_what_geometry_swallows_is_swallowed() -> None:
    one_sided = replace(Options(), approach="one_sided")
    for hidden, options in ((Hidden("backlash", (2,)), one_sided), (Hidden("measurement_scale"), Options())):
        truth = generate(case("seven", hidden, options=options)).truth.effects[0]
        assert truth.rms_mm > 0.02
        assert truth.lam < 0.01


@pytest.mark.parametrize(
    ("hidden", "rival"),
    [
        (Hidden("axial_compliance", (1,)), ("link_bending", (1,))),
        (Hidden("gravity_spring", (1,)), ("eccentricity", (2,))),
    ],
)
def test_known_aliases_look_alike(hidden: Hidden, rival: tuple[str, tuple[int, ...]]) -> None:
    truth = generate(case("elbow", hidden, options=Options(payload="one"))).truth.effects[0]
    assert next(r for r in truth.rivals if (r.id, r.joints) == rival).rho > 0.99
    assert truth.rho > 0.99


def test_an_alias_that_the_data_can_settle_is_not_called_undecidable() -> None:
    pair = (Hidden("axial_compliance", (2,)), Hidden("link_bending", (2,)))
    large = replace(case("elbow", pair[0], lam=300.0), expectation="undecidable", undecidable=pair)
    truth = generate(large).truth
    assert truth.expectation == "named"
    assert not truth.undecidable


def test_readings_scatter_as_stated() -> None:
    rng = np.random.default_rng(11)
    options = Options(repeats=3)
    p = np.tile([[2.0, -1.0, 1.5]], (4000, 1))
    readings, wrong = tracker.read(p, options, rng)
    assert not wrong.any()
    within = readings - readings.mean(axis=1, keepdims=True)
    stated = tracker.reading_covariance(p[:1], options)[0]
    found = np.einsum("vri,vrj->ij", within, within) / (4000 * 2)
    np.testing.assert_allclose(found, stated, atol=0.05 * np.trace(stated))
    stated = tracker.visit_covariance(p[:1], options)[0]
    np.testing.assert_allclose(np.cov(readings.mean(axis=1).T), stated, atol=0.07 * np.trace(stated))
    beam = p[0] / np.linalg.norm(p[0])
    across = np.cross(beam, [0.0, 0.0, 1.0])
    reading = tracker.reading_covariance(p[:1], options)[0]
    assert beam @ reading @ beam == pytest.approx((5e-6 + 0.5e-6 * np.linalg.norm(p[0])) ** 2)
    assert across @ reading @ across / (across @ across) == pytest.approx((3e-6 * np.linalg.norm(p[0])) ** 2)


def test_outliers_are_as_many_as_asked_and_known() -> None:
    campaign = generate(case("katana", poses=118, options=Options(outliers=0.02)))
    clean = generate(case("katana", poses=118, options=Options(outliers=0.0)))
    rows = len(campaign.columns["x_mm"])
    assert 0 < len(campaign.truth.outlier_rows) < 0.05 * rows
    assert not clean.truth.outlier_rows


def test_campaigns_hold_contrasts_and_repeats() -> None:
    campaign = generate(case("elbow", poses=60, options=Options(revisited=0.5)))
    o = observations_of(campaign.columns)
    assert o.direction is not None
    assert o.payload_kg is not None
    assert o.t is not None
    assert np.all(np.diff(o.t) > 0)
    kinds = {"same": 0, "direction": 0, "payload": 0}
    groups = o.pose_groups()
    for g in range(groups.max() + 1):
        rows = np.flatnonzero(groups == g)
        if len(rows) == 6:
            first, second = rows[0], rows[-1]
            turned = bool(np.any(o.direction[first] != o.direction[second]))
            loaded = bool(o.payload_kg[first] != o.payload_kg[second])
            kinds["direction" if turned else "payload" if loaded else "same"] += 1
    assert sum(kinds.values()) == 30
    assert min(kinds.values()) >= 7


def test_same_case_gives_same_numbers() -> None:
    chosen = list(cases(4, 6))[1]
    assert chosen == list(cases(4, 9))[1]
    first, second = generate(chosen), generate(chosen)
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, second.columns[name])
    assert first.truth == second.truth


def test_sample_covers_what_it_should() -> None:
    drawn = list(cases(0, 500))
    hidden = {h.id for c in drawn for h in c.hidden}
    assert hidden >= set(LIBRARY) - {"measurement_scale"} | {"payload_error"}
    assert hidden >= set(OUTSIDE)
    assert {h.id for c in twin_cases(0, 40) for h in c.hidden} == set(TWINS)
    assert {c.robot for c in drawn} == set(ARMS)
    assert {c.poses for c in drawn} == {30, 60, 118}
    assert {len(c.hidden) for c in drawn} == {0, 1, 2, 3}
    assert sum(not c.hidden for c in drawn) == 200
    assert sum(c.expectation == "no_gap" and bool(c.options.background) for c in drawn) == 70
    assert sum(c.expectation == "outside" for c in drawn) == 40
    for count in (1, 2, 3):
        assert sum(c.demanded and len(c.hidden) == count for c in drawn) == 80
    options = [c.options for c in drawn]
    assert min(o.mass_error for o in options) >= 0.0
    assert np.quantile([o.mass_error for o in options], [0.3, 0.9]) == pytest.approx([0.1, 0.2])
    for share in (
        np.mean([o.revisited == 0.0 for o in options]), np.mean([o.stays for o in options]),
        np.mean([o.shot_gap_s > 10.0 for o in options]), np.mean([o.clustered > 0.0 for o in options]),
        np.mean([bool(o.restricted) for o in options]), np.mean([(o.foot_m or 0.0) > 5.0 for o in options]),
        np.mean([o.confirmation for o in options]), np.mean([o.background in BACKGROUNDS for o in options]),
    ):  # fmt: skip
        assert 0.03 < share < 0.6


def test_no_link_expands_more_than_a_material_can() -> None:
    """At a temperature that hardly changes a growth that shows would be that of no solid: it stays small and unseen."""
    found = [e for c in cases(0, 252) for e in (generate(c).truth.effects if _grows(c) else ())]
    growths = [v for e in found if e.id in ("link_growth", "thermal_growth") for v in e.parameters.values()]
    assert len(growths) >= 3
    assert max(growths) <= 1e-4


def _grows(case: Case) -> bool:
    return case.options.temperature == "constant" and any(
        h.id in ("link_growth", "thermal_growth") for h in case.hidden
    )
