"""Whether a ball bar is as long as its readings say: by the sphere on which the joints put the tool, and by the fit.

The nominal arm only raises the question, because an arm that is to be calibrated is wrong by more than many bars are. What
answers it is the fit: with the length as read and with the length that the joints command, whose deviations are then left
by noise alone, and whose parameters are those of an arm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats

SHARE, LEAST_M = 0.01, 1e-3  # robots are truer than one part in a hundred
FEWEST_LENGTHS = 8  # readings of a bar
MARGIN = 6.0  # 2 log of a Bayes factor of 20, in favour of another length than was read
LARGEST_M = 1e-2  # left by a fit that says nothing of its rows: arms err by millimetres before they are calibrated
SMALLEST_M = 1e-7  # no bar and no arm leaves less
FLAT = 1e-3  # of the spread across a plane: the bar went round in it


def other_lengths(arm: Calibration, rows: Observations) -> list[tuple[int, float, float]]:
    """Bars (number, length read, length by the joints of ``arm``; m) for which the two differ by more than robots err."""
    if rows.bar is None or rows.bar_length is None:
        return []
    p = arm.predict(rows).position
    out = []
    for number in np.unique(rows.bar[rows.bar > 0]):
        mine = rows.bar == number
        read = float(np.mean(rows.bar_length[mine]))
        found = _radius(p[mine])
        if found is not None and abs(found - read) > max(SHARE * read, LEAST_M):
            out.append((int(number), read, found))
    return out


def scale_bar_readings(rows: Observations, bar: int, factor: float) -> Observations:
    """Rows whose readings of one bar are multiplied by a factor."""
    assert rows.bar is not None
    assert rows.bar_length is not None
    return replace(rows, bar_length=np.where(rows.bar == bar, factor, 1.0) * rows.bar_length)


def explains_better(other: Fit, fit: Fit) -> bool:
    """Whether a fit with another length says the same rows better, with parameters as plausible: by likelihood and priors.

    Of two fits of which neither comes near the rows, as of one circle that tells an arm too little, none says a length.
    """
    return _residual_rms(other) < LARGEST_M and _badness(other) < _badness(fit) - MARGIN


def _badness(fit: Fit) -> float:
    """Twice the negative log of likelihood, of noise of unknown size, times that of the priors."""
    left = fit.residual.points[np.isfinite(fit.residual.points)]
    problem, rows = fit.problem, len(fit.residual.points)
    moved = (fit.values[problem.free] - problem.prior_mean) / problem.prior_sigma
    return rows * float(np.log(max(float(left @ left) / rows, SMALLEST_M**2))) + float(moved @ moved)


def _residual_rms(fit: Fit) -> float:
    """What a fit leaves of its rows, rms, m."""
    left = fit.residual.points[np.isfinite(fit.residual.points)]
    return float(np.sqrt(np.mean(left**2))) if len(left) else np.inf


def _radius(p: Floats) -> float | None:
    """Radius of the sphere through the points, of the circle where they lie in a plane; None of too few or a short arc."""
    if len(p) < FEWEST_LENGTHS:
        return None
    middle = p.mean(axis=0)
    sizes, axes = np.linalg.svd(p - middle, full_matrices=False)[1:]
    kept = 2 if sizes[2] < FLAT * sizes[0] else 3
    local = (p - middle) @ axes[:kept].T
    solved = np.linalg.lstsq(np.column_stack([2 * local, np.ones(len(p))]), (local**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(solved[-1] + float(solved[:-1] @ solved[:-1]), 0.0)))
    # A short arc tells no radius.
    return radius if sizes[1] / np.sqrt(len(p)) > 0.2 * radius else None
