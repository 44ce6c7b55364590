"""Joints that reach a wanted tool point, by damped Newton steps from several starts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.robot import Robot
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

Floats = NDArray[np.float64]

STEPS = 40
STEP_LIMIT_RAD = 0.3
REACHED_M = 1e-7


def reach(robot: Robot, targets: Floats, starts: Floats, margin: float = 0.01) -> tuple[Floats, NDArray[np.bool_]]:
    """Joints (N, n) whose nominal tool point is at ``targets (N, 3)`` m in the frame of the robot's base pose.

    Newton steps of least norm from ``starts (N, n)``, kept inside the limits by ``margin`` of each joint's range, which
    leaves room for a correction. Returns the joints and which arrived.
    """
    model = RobotModel(robot)
    values = model.values0()
    lower, upper = robot.limits.T
    room = np.where(np.isfinite(upper - lower), margin * (upper - lower), 0.0)
    lower, upper = lower + room, upper - room
    q = np.clip(starts, lower, upper)
    for _ in range(STEPS):
        prediction, J = model.joint_jacobian(Observations(q), values)
        error = targets - prediction.position
        if np.max(np.linalg.norm(error, axis=1), initial=0.0) < REACHED_M:
            break
        A = J[:, :3]
        damped = A @ A.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        step = np.einsum("nij,ni->nj", A, np.linalg.solve(damped, error[:, :, None])[:, :, 0])
        q = np.clip(q + np.clip(step, -STEP_LIMIT_RAD, STEP_LIMIT_RAD), lower, upper)
    left = np.linalg.norm(targets - model.predict(Observations(q), values).position, axis=1)
    return q, left < 10 * REACHED_M
