"""A check by views: quiet where the arm is as it was, loud where a joint moved, refused for a camera it does not know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.watch import check
from tests.core.pixel_scene import eye_to_hand

SCENE = eye_to_hand(yielding=np.zeros(6))


def test_a_joint_that_moved_is_seen_by_the_camera() -> None:
    rng = np.random.default_rng(1)
    rows = SCENE.observed(SCENE.poses(60, rng), rng, 0.1)
    made = identify(robot_from_document(SCENE.drawn.document()), rows, None, IdentifyOptions())
    fresh = SCENE.poses(10, rng)
    still = check(made.calibration, SCENE.observed(fresh, rng, 0.1), made.predictive)
    assert still.verdict == "ok"
    crashed = fresh + np.array([0.0, 0.0, np.radians(0.3), 0.0, 0.0, 0.0])
    moved = replace(SCENE.observed(crashed, rng, 0.1), q=fresh, pose_id=None)
    found = check(made.calibration, moved, made.predictive)
    assert found.verdict in ("moved", "cannot_tell")
    assert found.p_value < 1e-6
    other = replace(moved, rig=replace(moved.rig, cameras=(replace(moved.rig.cameras[0], name="other"),)))
    with pytest.raises(ObservationError) as refused:
        check(made.calibration, other, made.predictive)
    assert refused.value.code == "camera_unknown"
