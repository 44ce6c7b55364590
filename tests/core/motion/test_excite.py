"""Planned motions: within limits and speeds, from rest to rest, and they show more than motions drawn by chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.errors import OptionError
from kilter_core.motion import MotionPlan, find_missing_torque, plan_motions
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Logger, State, ur_like
from tests.core.truth import Floats, some_arm, with_bodies

SPEED = (0.8, 0.1)


class Driven(Logger):
    """A logger whose arm drives what was planned: one motion, sampled as finely as its truth."""

    plan: MotionPlan

    def _path(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        spline = CubicSpline(self.plan.t, self.plan.q)
        inside = np.minimum(t, self.plan.t[-1])
        return spline(inside), spline(inside, 1), spline(inside, 2)


def ur() -> Robot:
    return robot_from_document(ur_like(np.random.default_rng(5)).document())


def test_motions_stay_within_limits_and_speeds_and_rest_at_both_ends() -> None:
    robot = ur()
    narrow = replace(
        robot,
        joints=(
            replace(robot.joints[0], lower=-0.2, upper=0.3),
            *robot.joints[1:5],
            replace(robot.joints[5], lower=1.0),
        ),
    )
    plan = plan_motions(narrow, 20.0, 2, 100.0, SPEED)
    rate = np.gradient(plan.q, plan.t, axis=0)
    change = np.gradient(rate, plan.t, axis=0)
    assert np.all((plan.q > narrow.limits[:, 0]) & (plan.q < narrow.limits[:, 1]))
    assert np.all(np.abs(rate) <= 1.02 * SPEED[0])
    assert np.all(np.abs(change) <= 1.1 * SPEED[0] / 0.5)
    for motion in (0, 1):
        (rows,) = np.nonzero(plan.motion == motion)
        assert np.abs(rate[rows[[0, -1]]]).max() < 0.02
        assert np.abs(plan.q[rows[0]] - plan.q[rows[-1]]).max() < 1e-6
    assert np.ptp(plan.motion[plan.motion >= 0]) == 1.0


def test_the_motions_that_are_chosen_show_more_than_those_that_were_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = plan_motions(ur(), 20.0, 2, speed=SPEED)
    monkeypatch.setattr("kilter_core.motion.excite.CANDIDATES", 1)
    drawn = [plan_motions(ur(), 20.0, 2, speed=SPEED, seed=seed).condition for seed in range(8)]
    assert chosen.condition < np.median(drawn)


def test_what_is_hidden_in_a_log_of_them_is_named() -> None:
    robot = ur()
    logger = Driven(ur_like(np.random.default_rng(5)), seed=5, motions=1)
    logger.plan = plan_motions(robot, 30.0, 4, speed=SPEED)
    logger.seconds = float(logger.plan.t[-1])

    def friction(state: State) -> Floats:
        return np.asarray(0.08 * np.sign(state.qd) * np.abs(state.rigid) * (np.arange(6) == 2))

    logger.extra = [friction]
    log = logger.log()
    found = find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"]))
    assert found.unseen
    assert found.motions == 4
    (one,) = found.judged
    assert (one.term.effect.id, one.term.joint) == ("load_friction", 2)
    assert one.verdict in ("confirmed", "class_confirmed")


def test_a_rail_moves_in_metres_and_a_short_motion_is_refused() -> None:
    robot = robot_from_document(_on_rail())
    plan = plan_motions(robot, 15.0, 1, speed=SPEED)
    rails = [j for j, joint in enumerate(robot.joints) if joint.kind == "prismatic"]
    assert rails
    assert np.all(plan.fastest[rails] <= 1.02 * SPEED[1])
    with pytest.raises(OptionError, match="too short"):
        plan_motions(robot, 5.0)


def _on_rail() -> dict[str, object]:
    rng = np.random.default_rng(4)
    return with_bodies(some_arm(rng, 5, prismatic=True), rng).document()
