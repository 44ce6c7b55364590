"""Joints that reach a point, checked by Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.model.general_inverse import reach
from tests.core.campaigns import joints
from tests.core.truth import some_arm


@pytest.mark.parametrize("n", [5, 6, 7])
def test_joints_reach_their_targets_within_the_limits(n: int) -> None:
    rng = np.random.default_rng(n)
    arm = some_arm(rng, n)
    targets, _ = arm.poses(joints(arm, 50, rng))
    q, arrived = reach(robot_from_document(arm.document()), targets, joints(arm, 50, rng))
    assert arrived.mean() > 0.5
    apart = np.linalg.norm(arm.poses(q)[0] - targets, axis=1)
    assert np.max(apart[arrived]) < 1e-6
    assert np.min(apart[~arrived], initial=1.0) > 1e-7
    assert (np.abs(q) < 2.5).all()


def test_what_is_out_of_reach_is_said() -> None:
    arm = some_arm(np.random.default_rng(0), 6)
    _, arrived = reach(robot_from_document(arm.document()), np.full((3, 3), 50.0), np.zeros((3, 6)))
    assert not arrived.any()
