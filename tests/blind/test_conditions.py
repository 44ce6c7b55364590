"""What makes a campaign hard: each condition is there, as large as it says, and nothing else changes with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.generator import Campaign, Case, Hidden, Options, cases, generate
from tests.blind.generator.arm import Deflection, built
from tests.blind.generator.arms import ARMS
from tests.blind.generator.background import KINDS, background_of
from tests.blind.generator.campaign import physics_of
from tests.blind.generator.outside import SMOOTH
from tests.blind.generator.sizing import displacement
from tests.blind.generator.visits import Visits, box_of, plan

Floats = NDArray[np.float64]
BARE = Options(outliers=0.0, revisited=0.5)


def case(*hidden: Hidden, poses: int = 36, lam: float = 100.0, **options: Any) -> Case:
    return Case("test", "elbow", hidden, (lam,) * 3, poses, replace(BARE, **options), "no_gap", 7)


def points(campaign: Campaign) -> Floats:
    return np.stack([campaign.columns[f"{axis}_mm"] for axis in "xyz"], axis=1)


def pooled_mm(campaign: Campaign, repeats: int = 3) -> float:
    """Scatter of the means of visits under one condition, pooled over the campaign, by brute force."""
    c = campaign.columns
    means = points(campaign).reshape(-1, repeats, 3).mean(axis=1)
    keys = [tuple(c[k][row] for k in ("pose_id", "payload_kg", "session", *(f"dir{i}" for i in range(1, 7))))
            for row in range(0, len(c["t_s"]), repeats)]  # fmt: skip
    same = [means[[k == key for k in keys]] for key in dict.fromkeys(keys)]
    squares = sum(float(np.sum((m - m.mean(axis=0)) ** 2)) for m in same)
    return float(np.sqrt(squares / (3 * sum(len(m) - 1 for m in same))))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("overstated", [1.5, 4.0])
def test_drifting_repeats_overstate_the_noise_as_much_as_said(kind: str, overstated: float) -> None:
    how = {"poses": 118, "spread": 1.0, "temperature": "cycling", "payload": "one", "revisited": 0.9}
    still = generate(case(**how))
    moving = generate(case(**how, background=kind, overstated=overstated))
    assert moving.truth.background is not None
    assert moving.truth.background.overstated == pytest.approx(overstated, rel=0.02)
    assert pooled_mm(moving) / pooled_mm(still) == pytest.approx(overstated, rel=0.3)
    assert still.truth.background is None


@pytest.mark.parametrize("kind", KINDS)
def test_a_background_is_slow(kind: str) -> None:
    rng = np.random.default_rng(9)
    arm = built(ARMS["elbow"](), rng)
    visits = plan(arm, 118, replace(BARE, temperature="cycling"), rng)
    physics = background_of(kind, arm, visits, rng)
    d = Deflection.none(len(visits), arm.n)
    physics.act(physics.typical, d)
    assert d.base.std() > 0.0
    assert np.abs(np.diff(d.base, axis=0)).max() < 0.2 * np.ptp(d.base, axis=0).max()
    assert not any(getattr(d, f).any() for f in ("dq", "tilt", "bend", "sag", "growth", "tool", "field", "scale"))


def test_shots_of_one_stop_share_where_the_arm_came_to_rest() -> None:
    made = generate(case(poses=60, approach_um=50.0, range_um=3.0, angle_urad=1.5, shot_gap_s=60.0))
    shots = points(made).reshape(-1, 3, 3)
    within = np.sqrt(np.mean(np.var(shots, axis=1, ddof=1)))
    assert within < 0.012
    assert pooled_mm(made) > 3.0 * within
    t = made.columns["t_s"].reshape(-1, 3)
    assert np.allclose(np.diff(t, axis=1), 60.0)
    assert np.all(t[1:, 0] - t[:-1, 2] >= 20.0)
    assert np.all(made.columns["pose_id"].reshape(-1, 3).std(axis=1) == 0)


def test_a_repeat_without_leaving_shows_nothing_of_the_approach() -> None:
    how = {
        "approach_um": 60.0,
        "range_um": 2.0,
        "angle_urad": 1.0,
        "payload": "one",
        "poses": 60,
        "approach": "one_sided",
    }
    assert pooled_mm(generate(case(**how))) > 0.04
    stays = generate(case(**how, stays=True))
    unchanged = np.diff(stays.columns["pose_id"].reshape(-1, 3)[:, 0]) == 0
    assert unchanged.sum() >= 9
    apart = np.diff(points(stays).reshape(-1, 3, 3).mean(axis=1), axis=0)[unchanged]
    assert np.sqrt(np.mean(apart**2)) < 0.01


def test_spread_repeats_come_late() -> None:
    def apart(spread: float) -> float:
        c = generate(case(poses=118, spread=spread, payload="one", approach="one_sided")).columns
        pose, t = c["pose_id"][::3], c["t_s"][::3]
        return float(np.median([np.ptp(t[pose == p]) for p in np.unique(pose) if np.sum(pose == p) > 1]) / np.ptp(t))

    assert apart(1.0) > 0.2
    assert apart(0.0) < apart(1.0)


def test_campaigns_without_repeats_have_none() -> None:
    made = generate(case(revisited=0.0, repeats=1))
    assert len(np.unique(made.columns["pose_id"])) == len(made.columns["pose_id"]) == 36


def test_clustered_readings_are_wrong_alike() -> None:
    how = {"poses": 118}
    wrong, right = generate(case(**how, clustered=0.15)), generate(case(**how))
    off = points(wrong) - points(right)
    rows = np.flatnonzero(np.linalg.norm(off, axis=1) > 1e-6)
    assert tuple(rows) == wrong.truth.outlier_rows
    assert len(rows) / len(off) == pytest.approx(0.15, abs=0.01)
    assert np.linalg.norm(off[rows].mean(axis=0)) == pytest.approx(0.5, rel=0.1)
    assert np.linalg.norm(off[rows] - off[rows].mean(axis=0), axis=1).max() < 0.2


def test_wrong_masses_change_what_is_told_and_nothing_else() -> None:
    known = generate(case())
    wrong = generate(case(mass_error=0.2, com_error_mm=10.0, payload_error=0.05))
    for column in ("x_mm", "q1_deg", "t_s"):
        np.testing.assert_array_equal(known.columns[column], wrong.columns[column])
    heavier = wrong.columns["payload_kg"].max() / 10.0
    assert heavier in (pytest.approx(0.95), pytest.approx(1.05))
    np.testing.assert_allclose(wrong.columns["payload_kg"], heavier * known.columns["payload_kg"])
    pairs = list(zip(wrong.document["links"], known.document["links"], strict=True))
    ratio = np.array([w["mass_kg"] / k["mass_kg"] for w, k in pairs])
    assert np.ptp(ratio) > 0.05
    assert np.all(np.abs(ratio - 1.0) <= 0.2)
    apart = np.array([np.subtract(w["com_mm"], k["com_mm"]) for w, k in pairs])
    assert 5.0 < np.abs(apart).max() <= 10.0 * np.sqrt(3.0)


def test_the_payload_hangs_beside_the_tool_point() -> None:
    soft = Hidden("axial_compliance", (5,))
    beside = generate(case(soft, payload_offset_mm=8.0)).columns["x_mm"]
    assert np.abs(beside - generate(case(soft)).columns["x_mm"]).max() > 1e-3


def test_the_foot_stands_where_it_is_put_and_leans() -> None:
    arm = built(ARMS["elbow"](), np.random.default_rng(1), 8.0, 0.3)
    assert np.linalg.norm(arm.foot[:3, 3]) == pytest.approx(8.0)
    assert np.degrees(np.arccos(arm.up[2])) == pytest.approx(0.3, rel=1e-3)
    usual = built(ARMS["elbow"](), np.random.default_rng(1))
    np.testing.assert_array_equal(usual.placements, arm.placements)


@pytest.mark.parametrize("robot", ARMS)
def test_restricted_joints_keep_within_their_range(robot: str) -> None:
    made = generate(replace(case(restricted=(0, 3)), robot=robot))
    for joint, most in ((1, 150.0), (4, 150.0), (5, 360.0)):
        assert np.ptp(made.columns[f"q{joint}_deg"]) <= most + 1e-9
    assert np.ptp(made.columns["q5_deg"]) > 200.0


@pytest.mark.parametrize("shape", SMOOTH)
def test_a_smooth_curve_is_a_sum_of_physical_ones(shape: str) -> None:
    rng = np.random.default_rng(2)
    options = Options(restricted=(3,))
    arm = built(ARMS["seven"](), rng)
    visits = plan(arm, 200, options, rng)
    q = visits.q[:, 3]
    base = np.stack([np.ones_like(q), q, np.sin(q), np.cos(q)], axis=1)
    for seed in range(5):
        physics = physics_of(Hidden(shape, (3,)), arm, visits, np.random.default_rng(seed))
        d = Deflection.none(len(visits), arm.n)
        physics.act(physics.typical, d)
        dq = d.dq[:, 3]
        left = dq - base @ np.linalg.lstsq(base, dq, rcond=None)[0]
        explained = 1.0 - np.sum(left**2) / np.sum((dq - dq.mean()) ** 2)
        assert explained > (0.3 if shape == "spline_curve" else 0.99)


def test_noncentrality_counts_the_poses_searched() -> None:
    rng = np.random.default_rng(4)
    arm = built(ARMS["elbow"](), rng)
    few, many = (plan(arm, n, BARE, np.random.default_rng(1)) for n in (59, 60))
    assert few.searched.all()
    assert len(np.unique(many.pose[many.searched])) == 45
    assert not set(many.pose[many.searched]) & set(many.pose[~many.searched])


def test_a_set_that_must_be_decidable_is() -> None:
    wanted = [c for c in cases(3, 60) if c.demanded][:10]
    made = [generate(c) for c in wanted]
    able = [all(e.decidable for e in m.truth.effects) for m in made]
    assert all(able)
    assert all(m.case.alternatives == () and not m.case.demanded for m in made)
    again = generate(made[3].case)
    np.testing.assert_array_equal(again.columns["x_mm"], made[3].columns["x_mm"])
    assert again.truth == made[3].truth


def test_the_second_campaign_is_of_the_same_arm_on_another_day() -> None:
    made = generate(case(Hidden("backlash", (2,)), lam=400.0, confirmation=True))
    first, second = made.columns, made.confirmation
    assert second is not None
    assert len(np.unique(second["pose_id"])) == 45
    assert not np.isin(second["q1_deg"], first["q1_deg"]).any()
    assert second["payload_kg"].max() == pytest.approx(first["payload_kg"].max() / 2.0)
    far = [np.mean([c[f"{a}_mm"] for a in "xyz"], axis=1) for c in (first, second)]
    assert np.linalg.norm(far[0] - far[1]) > 300.0
    assert generate(case(Hidden("backlash", (2,)), lam=400.0)).confirmation is None


def test_the_second_campaign_has_the_same_effects() -> None:
    """Without noise, play of a joint moves the tool between two visits of a pose from both sides, in both campaigns."""
    quiet = {"range_um": 1e-6, "range_um_per_m": 0.0, "angle_urad": 1e-6, "approach_um": 1e-6, "payload": "one"}
    made = generate(case(Hidden("backlash", (1,)), lam=1e8, confirmation=True, revisited=1.0, **quiet))
    sizes = []
    for c in (made.columns, made.confirmation):
        assert c is not None
        p = np.stack([c[f"{a}_mm"] for a in "xyz"], axis=1)
        turned = [rows for g in np.unique(c["pose_id"]) if np.ptp(c["dir2"][rows := np.flatnonzero(c["pose_id"] == g)])]
        sizes.append(np.max([np.linalg.norm(p[rows[0]] - p[rows[-1]]) for rows in turned]))
    assert sizes[0] > 1e-3
    assert sizes[1] == pytest.approx(sizes[0], rel=0.3)


def _visits(**options: Any) -> tuple[Any, Visits]:
    rng = np.random.default_rng(9)
    arm = built(ARMS["elbow"](), rng)
    return arm, plan(arm, 40, replace(BARE, temperature="cycling", **options), rng)


def _moved(effect: str, joints: tuple[int, ...], values: list[float]) -> tuple[Visits, Floats, Deflection]:
    arm, visits = _visits()
    physics = physics_of(Hidden(effect, joints), arm, visits, np.random.default_rng(0))
    d = Deflection.none(len(visits), arm.n)
    physics.act(np.array(values), d)
    return visits, displacement(arm, visits, physics, np.array(values)), d


def test_new_causes_are_what_they_say() -> None:
    visits, _, d = _moved("zero_drift", (2,), [1e-8])
    np.testing.assert_allclose(d.dq[:, 2], 1e-8 * (visits.t_s - visits.t_s[0]))
    assert not d.dq[:, [0, 1, 3, 4, 5]].any()
    visits, _, d = _moved("zero_thermal", (2,), [1e-6])
    np.testing.assert_allclose(d.dq[:, 2], 1e-6 * (visits.temperature_c - 20.0))
    visits, _, d = _moved("link_growth", (1,), [2e-5])
    np.testing.assert_allclose(d.growth[:, 2], 2e-5 * (visits.temperature_c - 20.0))
    assert not d.growth[:, [0, 1, 3, 4, 5, 6]].any()
    visits, _, d = _moved("hardening", (1,), [1e-8])
    about = visits.load.moment[:, 1, 2]
    np.testing.assert_allclose(d.dq[:, 1], -1e-8 * about * np.abs(about))
    visits, _, d = _moved("direction_compliance", (1,), [1e-6])
    np.testing.assert_allclose(d.dq[:, 1], 1e-6 * visits.direction[:, 1] * visits.load.moment[:, 1, 2])
    visits, _, d = _moved("reading_tilt", (1,), [1e-6, -2e-6])
    np.testing.assert_allclose(d.dq[:, 1], visits.load.moment[:, 1, :2] @ [1e-6, -2e-6])
    visits, _, d = _moved("column_bending", (), [1e-6, 2e-6])
    np.testing.assert_allclose(d.base[:, 3:5], np.outer(visits.temperature_c - 20.0, [1e-6, 2e-6]))


def test_a_settling_base_comes_to_rest_and_a_wandering_one_does_not_jump() -> None:
    visits, moved, _ = _moved("settling", (), [1e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
    size = np.linalg.norm(moved, axis=1)
    assert size[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(size) > 0)
    assert size[-1] - size[len(size) // 2] < 0.4 * size[len(size) // 2]
    visits, moved, _ = _moved("random_walk", (), [1e-4, 0.0, 0.0])
    steps = np.linalg.norm(np.diff(moved, axis=0), axis=1)
    assert steps.max() < 0.5 * np.ptp(np.linalg.norm(moved - moved[0], axis=1))
    assert len(visits) > 40


def test_a_gear_that_hardens_never_gives_way_backwards() -> None:
    pair = (Hidden("axial_compliance", (1,)), Hidden("hardening", (1,)))
    for seed in range(5):
        made = generate(replace(case(*pair, lam=60.0), seed=seed))
        soft, hard = made.truth.effects
        _, visits = _visits()
        most = np.abs(visits.load.moment[:, 1, 2]).max()
        assert soft.parameters["c_2"] > 1.5 * hard.parameters["h_2"] * most


def test_a_wrong_payload_shows_through_the_compliance_beside_it() -> None:
    made = generate(case(Hidden("axial_compliance", (1,)), Hidden("payload_error"), lam=200.0))
    soft, heavy = made.truth.effects
    assert heavy.id == "payload_error"
    assert heavy.inside
    assert 0.0 < abs(heavy.parameters["mass_0"]) <= 8.0
    assert any(r.id == "payload_error" for r in soft.rivals) or soft.rho < 1.0


def test_errors_of_the_circles_leave_the_range_alone() -> None:
    arm, visits = _visits()
    physics = physics_of(Hidden("azimuth_error"), arm, visits, np.random.default_rng(0))
    p = arm.positions(visits.q)
    for k in range(8):
        moved = displacement(arm, visits, physics, np.eye(8)[k] * 1e-6)
        assert np.abs(np.sum(moved * p, axis=1)).max() < 1e-9
        assert np.linalg.norm(moved, axis=1).max() > 1e-7


def test_the_box_is_within_the_limits() -> None:
    for name, drawn in ARMS.items():
        arm = built(drawn(), np.random.default_rng(0))
        box = box_of(arm, Options(restricted=tuple(range(arm.n))))
        assert np.all(box[:, 0] >= arm.drawn.limits[:, 0]), name
        assert np.all(box[:, 1] <= arm.drawn.limits[:, 1]), name
        assert np.all(np.ptp(box, axis=1) <= np.radians(150.0) + 1e-12), name
