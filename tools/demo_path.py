"""The thesis's circle (section 5.5.1) as joint setpoints of the nominal Katana 450."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.types import Floats

# Two of its quarter points and its centre, in the nominal base frame.
CENTRE_MM = (0.0, -300.0, 139.2893)
FIRST_MM = (0.0, -370.7107, 210.0)
SECOND_MM = (-100.0, -300.0, 139.2893)
# The posture the free motion of five joints around a three-dimensional path is drawn to.
POSTURE_DEG = (-90.0, 70.0, -110.0, 20.0, 0.0)

TOLERANCE_M = 1e-10
TOLERANCE_RAD = 1e-6
LARGEST_ITERATION = 200


@dataclass(frozen=True)
class Path:
    """A wanted path: times ``t (N,)`` s, nominal joints ``q (N, n)`` rad, tool points ``wanted (N, 3)`` m."""

    t: Floats
    q: Floats
    wanted: Floats


def circle(robot: Robot, *, seconds: float, rate_hz: float) -> Path:
    """Once round the circle at constant speed, starting and ending at its first point."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    angle = 2.0 * np.pi * t / seconds
    centre, first, second = (np.array(point) / 1000.0 for point in (CENTRE_MM, FIRST_MM, SECOND_MM))
    points = centre + np.outer(np.cos(angle), first - centre) + np.outer(np.sin(angle), second - centre)
    wanted = points @ robot.T_base[:3, :3].T + robot.T_base[:3, 3]
    return Path(t, _follow(robot, wanted), wanted)


def _follow(robot: Robot, wanted: Floats) -> Floats:
    """Joints (N, n) that bring the nominal tool to each point, each solved from the one before."""
    model = RobotModel(robot)
    values = model.values0()
    posture = np.radians(POSTURE_DEG)
    q = posture.copy()
    out = np.empty((len(wanted), robot.n_joints))
    for row, point in enumerate(wanted):
        for _ in range(LARGEST_ITERATION):
            prediction, jacobian = model.joint_jacobian(Observations(q=q[None]), values)
            across = np.linalg.pinv(jacobian[0, :3])
            miss = point - prediction.position[0]
            drift = (np.eye(len(q)) - across @ jacobian[0, :3]) @ (posture - q)
            if np.linalg.norm(miss) < TOLERANCE_M and np.linalg.norm(drift) < TOLERANCE_RAD:
                break
            q = q + across @ miss + drift
        out[row] = q
    return out
