"""The poses of a check: within what they may be, better than chance, and refused where they cannot show a zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects.registry import make_effect
from kilter_core.errors import RobotError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.model.region import Region, arm_points, entering
from kilter_core.watch import check, check_poses
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

NOISE = 5e-5
EXACT = Predictive((), np.zeros((0, 0)), 0.0, NOISE)


def perfect(seed: int) -> tuple[DriftingArm, Calibration]:
    arm = replace(some_arm(np.random.default_rng(seed)), zeros=np.zeros(6), compliance=np.zeros(6))
    return arm, Calibration.nominal(robot_from_document(arm.document()))


@pytest.mark.parametrize("draws", [8, pytest.param(25, marks=pytest.mark.slow)])
def test_planned_poses_name_a_change_that_random_ones_just_see_more_often(draws: int) -> None:
    arm, calibration = perfect(0)
    rng = np.random.default_rng(1)
    plan = check_poses(calibration, EXACT, 5, Region.from_calibration(calibration), seed=0)
    assert (plan.q.shape, plan.found.verdict) == ((5, 6), "ok")
    others = [some_poses(5, rng) for _ in range(draws)]
    shown = [check(calibration, arm.measured(q, rng, NOISE), EXACT).smallest for q in others]
    causes = ("zero_2", "zero_3", "zero_4", "zero_5", "sag_2", "sag_3", "base", "tool", "scale")
    planned = random = 0
    for change in causes:
        moved = arm.after(change, 1.3 * float(np.median([one[change] for one in shown])))
        for q in others:
            planned += check(calibration, moved.measured(plan.q, rng, NOISE), EXACT).verdict == "moved"
            random += check(calibration, moved.measured(q, rng, NOISE), EXACT).verdict == "moved"
    total = len(others) * len(causes)
    assert planned > 0.87 * total
    assert planned > random + 0.1 * total


def test_a_zero_that_no_pose_shows_well_holds_up_no_other() -> None:
    """The last joint is seen by the lever of the reflector alone, whatever the poses."""
    arm, calibration = perfect(3)
    rng = np.random.default_rng(2)
    planned = check_poses(calibration, EXACT, 6, Region.from_calibration(calibration), seed=0).found.smallest
    shown = [check(calibration, arm.measured(some_poses(6, rng), rng, NOISE), EXACT).smallest for _ in range(25)]
    random = {name: float(np.median([one[name] for one in shown])) for name in planned}
    assert planned["zero_6"] == pytest.approx(random["zero_6"], rel=0.1)
    assert planned["zero_4"] < 0.92 * random["zero_4"]
    assert all(planned[f"zero_{k}"] < 1.05 * random[f"zero_{k}"] for k in range(1, 6))


def test_what_it_promises_is_seen_and_named() -> None:
    arm, calibration = perfect(0)
    rng = np.random.default_rng(2)
    plan = check_poses(calibration, EXACT, 5, Region.from_calibration(calibration), seed=0)
    for change in ("zero_2", "zero_4", "sag_2", "scale", "base", "tool"):
        moved = arm.after(change, 1.5 * plan.found.smallest[change])
        found = [check(calibration, moved.measured(plan.q, rng, NOISE), EXACT) for _ in range(20)]
        assert sum(one.verdict != "ok" for one in found) >= 18, change
        assert sum(change in [c.cause.name for c in one.causes] for one in found) >= 18, change


def test_poses_keep_to_limits_boxes_and_out_of_zones() -> None:
    _, calibration = perfect(3)
    zone = np.array([[[0.1, -2.0, -2.0], [2.0, 2.0, 0.4]]])
    region = Region.from_calibration(calibration).above(-0.2).outside(zone)
    plan = check_poses(calibration, EXACT, 5, region, seed=1)
    limits = calibration.robot.limits
    assert ((plan.q >= limits[:, 0]) & (plan.q <= limits[:, 1])).all()
    points = arm_points(calibration.robot, plan.q)
    assert points[:, 2:, 2].min() >= -0.2
    along = np.linspace(0.0, 1.0, 101)[:, None, None, None]
    lines = points[None, :, :-1] * (1.0 - along) + points[None, :, 1:] * along
    assert not ((lines > zone[0, 0]) & (lines < zone[0, 1])).all(axis=3).any()


def test_a_zone_is_entered_by_lines_and_not_only_by_points() -> None:
    box = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    through = np.array([[[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0]]])
    beside = np.array([[[-3.0, 1.5, 0.0], [3.0, 1.5, 0.0]]])
    before = np.array([[[-3.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]])
    inside = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]])
    slanted = np.array([[[-2.0, 0.0, 0.0], [0.0, 2.5, 0.0]]])
    assert [bool(entering(one, box)[0]) for one in (through, beside, before, inside, slanted)] == [
        True, False, False, True, False,
    ]  # fmt: skip


def test_a_reflector_on_the_last_axis_is_refused_with_the_distance_it_needs() -> None:
    arm, _ = perfect(4)
    tool = arm.tool.copy()
    tool[:2, 3] = [0.002, 0.001]
    robot = robot_from_document(replace(arm, tool=tool).document())
    near = Calibration.nominal(robot)
    with pytest.raises(
        RobotError, match=r"2.24 mm off the axis of joint 6: 5 poses .* \(`without_joints` 6\)"
    ) as refused:
        check_poses(near, EXACT, 5, Region.from_calibration(near))
    assert refused.value.code == "tool_on_axis"
    assert refused.value.context["joint"] == 6
    plan = check_poses(near, EXACT, 5, Region.from_calibration(near), without=[6])
    assert plan.found.smallest["zero_6"] > np.radians(0.25)
    tool[:2, 3] = [1.3 * refused.value.context["needed_m"], 0.0]  # what it says is enough
    far = Calibration.nominal(robot_from_document(replace(arm, tool=tool).document()))
    assert check_poses(far, EXACT, 5, Region.from_calibration(far)).found.smallest["zero_6"] < np.radians(0.25)


def test_what_would_show_a_faint_zero_does() -> None:
    arm, calibration = perfect(3)
    plan = check_poses(calibration, EXACT, 6, Region.from_calibration(calibration), seed=0)
    (faint,) = [one for one in plan.faint if one.cause.name == "zero_6"]
    lever = float(np.hypot(arm.tool[0, 3], arm.tool[1, 3]))
    assert faint.lever == pytest.approx(lever, rel=1e-6)
    assert faint.seen == plan.found.smallest["zero_6"]
    assert faint.needed is not None
    assert faint.poses is not None
    tool = arm.tool.copy()
    tool[:2, 3] *= 1.02 * faint.needed / lever
    farther = Calibration.nominal(robot_from_document(replace(arm, tool=tool).document()))
    assert "zero_6" not in [
        one.cause.name for one in check_poses(farther, EXACT, 6, Region.from_calibration(farther)).faint
    ]
    rng = np.random.default_rng(0)
    more = arm.measured(some_poses(round(1.1 * faint.poses), rng), rng, NOISE)
    assert check(calibration, more, EXACT).smallest["zero_6"] <= np.radians(0.03)
    assert all(plan.found.smallest[one.cause.name] > np.radians(0.03) for one in plan.faint)


def test_the_same_seed_plans_the_same_poses() -> None:
    _, calibration = perfect(5)
    region = Region.from_calibration(calibration)
    one, two, other = (check_poses(calibration, EXACT, 4, region, seed=seed).q for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("effect", ["backlash", "friction_windup", "drift", "session_shift", "thermal_growth"])
def test_a_check_is_planned_for_a_version_whose_effects_need_conditions(effect: str) -> None:
    _, nominal = perfect(0)
    options = {"session_shift": {"sessions": [1, 2]}, "drift": {"t0_s": 0.0}}.get(effect, {})
    calibration = nominal.with_effects([make_effect(effect, **options)])
    plan = check_poses(calibration, EXACT, 5, Region.from_calibration(calibration), seed=0)
    assert (plan.q.shape, plan.found.verdict) == ((5, 6), "ok")
    assert plan.found.smallest["zero_3"] < np.radians(0.1)
