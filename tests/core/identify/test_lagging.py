"""Readings that lag behind the command pass for a backlash of every joint: Pinocchio's arm has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.plausibility.belonging import lag_warnings
from kilter_core.observations import Observations
from tests.core.truth import Arm, Step, ur10

Floats = NDArray[np.float64]
LAG = np.radians(0.033)  # between the two directions
ARM = ur10()
ROBOT = robot_from_document(ARM.document())
CODE = "readings_follow_motion"


def campaign(lag: float, count: int = 90, seed: int = 3) -> Observations:
    """The arm is where it was sent; its log lags by half of ``lag`` behind the last motion, and servos wander a little."""
    rng = np.random.default_rng(seed)
    command, side = rng.uniform(-2.0, 2.0, (count, 6)), rng.choice([-1.0, 1.0], (count, 6))
    measured = ARM.poses(command)[0] + rng.normal(0.0, 1e-5, (count, 3))
    read = command - 0.5 * lag * side + rng.normal(0.0, 2e-6, (count, 6))
    return Observations(read, position=measured, direction=side, command=command)


def test_a_lag_looks_like_a_backlash_of_every_joint_and_is_warned_of() -> None:
    rows = campaign(LAG)
    options = IdentifyOptions(effects=("backlash",), noise_mm=0.01)
    found = identify(ROBOT, rows, options=options)
    values = dict(zip(found.calibration.names, found.calibration.values, strict=True))
    assert all(values[f"backlash_{j}"] == pytest.approx(LAG, rel=0.1) for j in range(1, 6))
    (warning,) = [w for w in found.warnings if w["code"] == CODE]
    assert warning["joints"] == [1, 2, 3, 4, 5, 6]
    assert "joint 2 by 0.033 deg" in warning["message"]
    sent = identify(ROBOT, replace(rows, q=rows.command, command=None), options=options)  # type: ignore[arg-type]
    values = dict(zip(sent.calibration.names, sent.calibration.values, strict=True))
    assert all(abs(values[f"backlash_{j}"]) < 0.08 * LAG for j in range(1, 6))
    assert CODE not in {w["code"] for w in sent.warnings}


def test_a_search_warns_too() -> None:
    quick = GapOptions(effects=("backlash", "eccentricity"), resamples=5, permutations=2, next_poses=0, noise_mm=0.01)
    assert CODE in {w["code"] for w in find_gap(ROBOT, campaign(LAG), quick).warnings}


def test_servos_that_wander_are_nothing_to_say() -> None:
    assert lag_warnings(ROBOT, campaign(0.0)) == []
    assert lag_warnings(ROBOT, replace(campaign(LAG), command=None)) == []
    assert lag_warnings(ROBOT, replace(campaign(LAG), direction=np.ones((90, 6)))) == []  # from one side: no difference


def test_without_directions_the_commands_say_where_a_joint_came_from() -> None:
    rng = np.random.default_rng(1)
    command = np.cumsum(rng.normal(0.0, 0.2, (40, 6)), axis=0)
    side = np.sign(np.diff(command, axis=0, prepend=command[:1]))
    read = command.copy()
    read[:, 3] -= 0.5 * LAG * side[:, 3]
    rows = Observations(read, command=command, t=np.arange(40.0))
    back = rows.select(np.arange(40)[::-1])  # the clock orders them
    for given in (rows, back):
        (warning,) = lag_warnings(ROBOT, given)
        assert warning["joints"] == [4]


def test_a_slide_is_told_in_millimetres_and_campaigns_without_commands_stay_silent() -> None:
    arm = robot_from_document(Arm((Step("tx", 0.0, 0), Step("rz", 0.0, 1), Step("tx", 0.3)), 2).document())
    side = np.tile([[1.0], [-1.0]], (10, 2))
    rows = Observations(side * [2e-5, 0.0], command=np.zeros((20, 2)), direction=side, position=np.zeros((20, 3)))
    (warning,) = lag_warnings(arm, rows)
    assert "joint 1 by 0.04 mm" in warning["message"]
    both = Observations.concatenate([rows, replace(rows, command=None)])
    assert both.command is not None
    assert np.isnan(both.command[20:]).all()
    assert lag_warnings(arm, both)[0]["joints"] == [1]
