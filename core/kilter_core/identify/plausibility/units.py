"""Whether measured points are in the unit they are said to be in: by what the joints command."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.identify.plausibility.placed import place, untold
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats

# real size over stated size -> what was called what, for values said to be in mm
FACTORS = (1e-3, 1 / 25.4, 1e-2, 0.1, 10.0, 25.4, 100.0, 1e3)
LEAST_MOTION_M = 0.02
GOOD, BAD = 0.05, 0.25  # of what the chain's lengths move is left when the points fit the robot, and when they do not


def unit_factor(robot: Robot, q: Floats, points: Floats) -> float | None:
    """By how much ``points (N, 3)`` m must be multiplied to fit the robot at joints ``q (N, n)``; None where they may fit.

    The point may sit anywhere on the tool and the instrument may be anywhere: both are fitted for every factor. What a tool
    of any length takes up, as of points on a sphere, tells no unit.
    """
    seen = ~np.isnan(points).any(axis=1)
    model = Calibration.nominal(robot).model
    pose = model.in_frames(np.eye(4), np.eye(4)).predict(Observations(q[seen]), model.values0())
    p = points[seen]
    flange = np.tile(np.eye(4), (len(p), 1, 1))
    flange[:, :3, :3], flange[:, :3, 3] = pose.rotation, pose.position
    motion = untold(flange) if len(p) else 0.0
    if len(p) < 6 or motion < LEAST_MOTION_M:
        return None
    fits = place(flange, p).size / motion
    if not fits > BAD:  # as nearly always: nothing else needs to be tried
        return None
    left = np.array([place(flange, factor * p).size for factor in FACTORS]) / motion
    best = int(np.argmin(left))
    return FACTORS[best] if left[best] < GOOD and left[best] < 0.2 * fits else None
