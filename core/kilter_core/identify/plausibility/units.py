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
    left = {factor: _left(pose.position, pose.rotation, factor * p, tool) / motion for factor in (1.0, *FACTORS)}
    best = min(FACTORS, key=lambda factor: left[factor])
    return best if left[1.0] > BAD and left[best] < GOOD and left[best] < 0.2 * left[1.0] else None


def _left(f: Floats, F: Floats, p: Floats, tool: Floats) -> float:
    """Root mean square m that is left when base and tool point are fitted in turn, the flange at (F, f)."""
    for _ in range(ROUNDS):
        body = f + F @ tool
        a, b = body.mean(axis=0), p.mean(axis=0)
        R = nearest_rotation((body - a).T @ (p - b))
        local = (p - b) @ R.T + a
        tool = np.einsum("nji,nj->ni", F, local - f).mean(axis=0)
    rest = f + F @ tool - local
    return float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
