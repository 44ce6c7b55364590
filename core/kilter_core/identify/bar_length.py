"""Whether a ball bar is as long as its readings say: by the sphere on which the joints put the tool."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.robot import Robot
from kilter_core.model import Calibration
from kilter_core.observations import Observations

Floats = NDArray[np.float64]

SHARE, LEAST_M = 0.01, 1e-3  # robots are truer than one part in a hundred
FEWEST = 8
FLAT = 1e-3  # of the spread across a plane: the bar went round in it


def other_lengths(robot: Robot, rows: Observations) -> list[tuple[int, float, float]]:
    """Bars (number, length read, length that the joints command; m) for which the two cannot both be."""
    if rows.bar is None or rows.bar_length is None:
        return []
    p = Calibration.nominal(robot).predict(rows).position
    out = []
    for number in np.unique(rows.bar[rows.bar > 0]):
        mine = rows.bar == number
        read = float(np.mean(rows.bar_length[mine]))
        found = _radius(p[mine])
        if found is not None and abs(found - read) > max(SHARE * read, LEAST_M):
            out.append((int(number), read, found))
    return out


def _radius(p: Floats) -> float | None:
    """Radius of the sphere through the points, of the circle where they lie in a plane; None of too few or a short arc."""
    if len(p) < FEWEST:
        return None
    middle = p.mean(axis=0)
    sizes, axes = np.linalg.svd(p - middle, full_matrices=False)[1:]
    kept = 2 if sizes[2] < FLAT * sizes[0] else 3
    local = (p - middle) @ axes[:kept].T
    solved = np.linalg.lstsq(np.column_stack([2 * local, np.ones(len(p))]), (local**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(solved[-1] + float(solved[:-1] @ solved[:-1]), 0.0)))
    # A short arc tells no radius.
    return radius if sizes[1] / np.sqrt(len(p)) > 0.2 * radius else None
