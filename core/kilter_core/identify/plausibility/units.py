"""Whether measured points are in the unit they are said to be in: by what the joints command."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Floats

# real size over stated size -> what was called what, for values said to be in mm
FACTORS = (1e-3, 1 / 25.4, 1e-2, 0.1, 10.0, 25.4, 100.0, 1e3)
LEAST_MOTION_M = 0.02
GOOD, BAD = 0.05, 0.25  # of the motion is left when the points fit the robot, and when they do not
ROUNDS = 30


def unit_factor(robot: Robot, q: Floats, points: Floats) -> float | None:
    """By how much ``points (N, 3)`` m must be multiplied to fit the robot at joints ``q (N, n)``; None where they may fit.

    The point may sit anywhere on the tool and the instrument may be anywhere: both are fitted for every factor.
    """
    seen = ~np.isnan(points).any(axis=1)
    model = Calibration.nominal(robot).model
    pose = model.in_frames(np.eye(4), np.eye(4)).predict(Observations(q[seen]), model.values0())
    tool, p = model.T_tool[:3, 3], points[seen]
    motion = float(np.linalg.norm(pose.position - pose.position.mean(axis=0), axis=1).mean()) if len(p) else 0.0
    if len(p) < 6 or motion < LEAST_MOTION_M:
        return None
    fits = _left(pose.position, pose.rotation, p[None], tool)[0] / motion
    if not fits > BAD:  # as nearly always: nothing else needs to be tried
        return None
    left = _left(pose.position, pose.rotation, np.multiply.outer(FACTORS, p), tool) / motion
    best = int(np.argmin(left))
    return FACTORS[best] if left[best] < GOOD and left[best] < 0.2 * fits else None


def _left(f: Floats, F: Floats, p: Floats, tool: Floats) -> Floats:
    """Root mean square m that is left of each of ``p (K, N, 3)``: base and tool point are fitted in turn, flange at (F, f)."""
    tool = np.broadcast_to(tool, (len(p), 3))
    b = p - p.mean(axis=1, keepdims=True)
    for _ in range(ROUNDS):
        body = f + _rotated(F, tool)
        a = body.mean(axis=1, keepdims=True)
        R = nearest_rotation((body - a).swapaxes(1, 2) @ b)
        local = b @ R.swapaxes(1, 2) + a
        tool = np.einsum("nji,knj->ki", F, local - f) / len(f)
    rest = f + _rotated(F, tool) - local
    return np.asarray(np.sqrt(np.mean(np.sum(rest**2, axis=2), axis=1)))


def _rotated(F: Floats, points: Floats) -> Floats:
    """Points (K, 3) in the frames (N, 3, 3), (K, N, 3)."""
    return np.asarray((F.reshape(-1, 3) @ points.T).T.reshape(len(points), -1, 3))
