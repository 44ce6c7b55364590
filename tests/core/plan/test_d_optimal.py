"""Poses whose tool stays in a box, and what is said of a box that cannot be filled."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects import make_effect
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.model.region import Region
from kilter_core.plan.d_optimal import d_optimal_poses
from tests.core.truth import ur10

ROBOT = robot_from_document(ur10().document())


def test_the_tool_stays_in_the_box_and_the_joints_in_their_limits() -> None:
    box = np.array([[0.2, -0.6, 0.1], [0.9, 0.6, 0.8]])
    start = Calibration.nominal(ROBOT)
    q = d_optimal_poses(start, 12, seed=1, region=Region.from_calibration(start).restrict_to_box(box)).q
    points = ur10().poses(q)[0]
    assert len(np.unique(q, axis=0)) == 12
    assert ((points >= box[0]) & (points <= box[1])).all()
    lower, upper = ROBOT.limits.T
    assert ((q > lower) & (q < upper)).all()
    free = ur10().poses(d_optimal_poses(start, 12, seed=1).q)[0]
    assert not ((free >= box[0]) & (free <= box[1])).all()


def test_a_box_out_of_reach_is_refused() -> None:
    start, far = Calibration.nominal(ROBOT), np.array([[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]])
    with pytest.raises(RobotError, match="with the tool in the box"):
        d_optimal_poses(start, 5, region=Region.from_calibration(start).restrict_to_box(far))


def test_directions_and_loads_stand_where_they_matter() -> None:
    start = Calibration.nominal(ROBOT)
    plain = d_optimal_poses(start, 6, [make_effect("eccentricity").configure_for_robot(ROBOT)], payloads_kg=(0.0, 5.0))
    assert plain.direction is None
    assert plain.payload_kg is None
    rows = d_optimal_poses(
        start,
        12,
        [make_effect(e).configure_for_robot(ROBOT) for e in ("backlash", "axial_compliance")],
        payloads_kg=(0.0, 5.0),
    )
    assert rows.direction is not None
    assert set(np.unique(rows.direction)) == {-1.0, 1.0}
    assert rows.payload_kg is not None
    assert set(rows.payload_kg) <= {0.0, 5.0}
