"""How far off the tool may be by what a fit to views leaves open, which views that are held out hardly show.

A camera tells where a board is across its line of sight, and ten times worse along it. If the whole cell, arm and distances,
is a thousandth larger than fitted, no corner moves across: only the board is seen a thousandth larger. So errors that are seen
through views, held out or not, have next to nothing of an error of size. The covariance of the fit has all of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from kilter_core.identify.options import FRAME_NAMES
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.spread import evenly

FRAMES = (*(f"base_{k}" for k in FRAME_NAMES), *(f"tool_{k}" for k in FRAME_NAMES[:3]))  # rotated, no point moves
MOST = 500  # rows at which it is looked
SEEN = 1e-9  # share of the largest singular value of what frames move below which they move nothing
UPPER = 0.975


@dataclass(frozen=True)
class LeftOpen:
    """Root mean square distance ``rms`` m of the tool that is expected, and the upper end ``high`` m of its 95 % interval."""

    rms: float
    high: float


def left_open(calibration: Calibration, known: Predictive, rows: Observations) -> LeftOpen:
    """By the covariance of the parameters, at the poses of ``rows``, with base and tool where they fit best there."""
    rows = rows.select(evenly(len(rows), MOST))
    names = list(calibration.names)
    own = [k for k, name in enumerate(names) if name in known.names and name not in FRAMES]
    free = np.array(sorted({*own, *(names.index(name) for name in FRAMES)}), dtype=np.int64)
    J = calibration.model.jacobian(rows, calibration.values, free, False)[1][:, :3].reshape(3 * len(rows), -1)
    frame = np.array([names[k] in FRAMES for k in free])
    u, s, _ = np.linalg.svd(J[:, frame], full_matrices=False)
    u = u[:, s > SEEN * s[0]]
    arm = J[:, ~frame] - u @ (u.T @ J[:, ~frame])
    place = [known.names.index(names[k]) for k in free[~frame]]
    # Few directions are open, often one: the sum of their squares scatters as that of so many numbers (Satterthwaite 1946).
    square = arm.T @ arm @ known.covariance[np.ix_(place, place)]
    whole = float(np.trace(square))
    if whole <= 0.0:
        return LeftOpen(0.0, 0.0)
    directions = whole**2 / float(np.sum(square * square.T))
    rms = float(np.sqrt(whole / len(rows)))
    return LeftOpen(rms, rms * float(np.sqrt(2.0 * gammaincinv(directions / 2.0, UPPER) / directions)))
