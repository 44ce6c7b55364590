"""Wind-up and backlash, one column in positions, told apart by torques: Pinocchio moves the arm, bends and holds it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.motion import find_missing_torque, with_torques_told
from kilter_core.observations import Observations
from kilter_service.jobs.setups import to_json_types
from tests.core.motion.moving_arm import Logger
from tests.core.motion.test_loads import solid
from tests.core.truth import Floats

JOINT, SOFT, NOISE_M = 1, 4e-5, 2e-5  # joint from 0, rad/(N m)
EFFECTS = ("axial_compliance", "backlash", "friction_windup", "eccentricity", "encoder_scale")


@pytest.fixture(scope="module")
def logged() -> tuple[Logger, Robot]:
    """An arm with its log, and its robot that knows what the log says."""
    logger = Logger(solid(), seed=31)
    log, robot = logger.log(), robot_from_document(solid().document())
    model = find_missing_torque(robot, Observations(q=log["q"], t=log["t"], tau=log["tau"])).model.to_document()
    return logger, with_torques_told(robot, json.loads(json.dumps(to_json_types(model))))


def poses(half_rad: float, seed: int) -> Observations:
    """Poses that each joint came to from either side, and stopped short by half of a reversal, under its own weight."""
    rng, arm = np.random.default_rng(seed), solid()
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.2, 1.2, (120, 6))
    side = rng.choice([-1.0, 1.0], (120, 6))
    stands: Floats = q.copy()
    stands[:, JOINT] += -SOFT * arm.torques(q)[:, JOINT] - half_rad * side[:, JOINT]
    return Observations(q, position=arm.poses(stands)[0] + rng.normal(0.0, NOISE_M, (120, 3)), direction=side)


def searched(robot: Robot, rows: Observations) -> GapReport:
    options = GapOptions(effects=EFFECTS, resamples=20, permutations=10, next_poses=0, noise_mm=1e3 * NOISE_M)
    return find_gap(robot, rows, options, validation=0.25)


def claims(report: GapReport) -> dict[str, tuple[str, set[str]]]:
    return {
        j.evidence.candidate.id: (j.claim.said, {a.candidate.id for a in j.alias_set})
        for j in report.effects
        if j.evidence.candidate.id != "axial_compliance"
    }


def test_the_friction_of_a_log_is_that_of_the_arm(logged: tuple[Logger, Robot]) -> None:
    logger, robot = logged
    assert robot.told_friction is not None
    value, sigma = robot.told_friction.T
    assert np.all(np.abs(value - logger.friction.coulomb) < 3.0 * sigma)
    assert np.all(sigma < 0.15 * logger.friction.coulomb)


def test_friction_that_winds_a_joint_up_is_named(logged: tuple[Logger, Robot]) -> None:
    logger, robot = logged
    rows = poses(SOFT * logger.friction.coulomb[JOINT], 1)
    report = searched(robot, rows)
    assert claims(report) == {"friction_windup": ("member", set())}
    assert [e.verdict for e in report.effects if e.evidence.candidate.id == "friction_windup"] == ["confirmed"]
    (effect,) = [e for e in report.to_document()["effects"] if e["id"] == "friction_windup"]
    (told,) = [one for one in effect["claim"]["evidence"] if one["name"] == "friction"]
    assert told["met"]
    assert "friction times compliance of joint 2 is" in told["told"]
    without = claims(searched(replace(robot, told_friction=None), rows))
    assert without == {"backlash": ("class", {"friction_windup"})}


def test_clearance_is_named_where_friction_cannot_have_done_it(logged: tuple[Logger, Robot]) -> None:
    logger, robot = logged
    rows = poses(4.0 * SOFT * logger.friction.coulomb[JOINT], 2)
    assert claims(searched(robot, rows)) == {"backlash": ("member", set())}


@pytest.mark.parametrize("times", [0.4, 1.6, -1.0])
def test_neither_is_named_where_friction_is_a_part_or_the_joint_runs_ahead(
    logged: tuple[Logger, Robot], times: float
) -> None:
    logger, robot = logged
    found = claims(searched(robot, poses(times * SOFT * logger.friction.coulomb[JOINT], 3)))
    assert found == {"backlash": ("class", {"friction_windup"})}
