"""Poses whose tool stays in a box, and what is said of a box that cannot be filled."""

from __future__ import annotations

import numpy as np
import pytest

from core.design.d_optimal import d_optimal_poses
from core.errors import RobotError
from core.model import Calibration
from core.robots import robot_from_document
from tests.core.truth import ur10

ROBOT = robot_from_document(ur10().document())


def test_the_tool_stays_in_the_box_and_the_joints_in_their_limits() -> None:
    box = np.array([[0.2, -0.6, 0.1], [0.9, 0.6, 0.8]])
    q = d_optimal_poses(Calibration.nominal(ROBOT), 12, seed=1, box=box)
    points = ur10().poses(q)[0]
    assert len(np.unique(q, axis=0)) == 12
    assert ((points >= box[0]) & (points <= box[1])).all()
    lower, upper = ROBOT.limits.T
    assert ((q > lower) & (q < upper)).all()
    free = ur10().poses(d_optimal_poses(Calibration.nominal(ROBOT), 12, seed=1))[0]
    assert not ((free >= box[0]) & (free <= box[1])).all()


def test_a_box_out_of_reach_is_refused() -> None:
    with pytest.raises(RobotError, match="larger box"):
        d_optimal_poses(Calibration.nominal(ROBOT), 5, box=np.array([[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]]))
