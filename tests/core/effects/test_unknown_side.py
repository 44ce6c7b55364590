"""A joint that came from nobody knows which side: a row is off by half its backlash, either way."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects import make_effect
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.correct.twins import ARMS

WIDTH_RAD = 2e-3


def test_what_is_not_known_of_a_row_is_half_the_backlash_of_its_joint() -> None:
    arm = ARMS["six"]
    robot = robot_from_document(arm.document())
    model = RobotModel(robot, (make_effect("backlash", joints=(2,)),))
    values = model.values0()
    values[model.names.index("backlash_3")] = WIDTH_RAD
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 6))
    direction = np.ones_like(q)
    direction[[1, 4], 2] = 0.0
    direction[3, 1] = 0.0  # of a joint without backlash
    _, open_ = model.doubts(Observations(q=q, direction=direction), values)
    side = np.zeros(6)
    side[2] = 0.5 * WIDTH_RAD
    expected = 0.5 * (arm.poses(q + side)[0] - arm.poses(q - side)[0])
    expected[[0, 2, 3, 5]] = 0.0
    np.testing.assert_allclose(open_[:, :3, 0], expected, atol=1e-8)
    assert np.linalg.norm(expected[1]) > 1e-4
    _, none = model.doubts(Observations(q=q, direction=np.ones_like(q)), values)
    assert none.shape[2] == 0
