"""Views whose joints are not theirs, or whose corners are wrong: what is left of them when all others are fitted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from kilter_core.identify.plausibility.views.view_residuals import NUMBERS, ViewResiduals
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats, Ints

FAR = 25.0  # times the usual square of what is left, five deviations, beyond which a view does not count
MOST = 0.25  # share of the views above which it is not known which are wrong
PASSES = 12
LISTED = 20


def astray(seen: ViewResiduals) -> Bools:
    """Views (K,) that are far from where the others put the tool; none where too many are."""
    far = np.zeros(len(seen.rows), dtype=bool)
    weight = np.ones(len(far))
    for _ in range(PASSES):  # a few wrong ones have moved the fit: those that stand out are first weighed down
        square = np.sum(_refitted_residuals(seen, weight) ** 2, axis=1) / NUMBERS
        weight = 1.0 / (1.0 + square / max(float(np.median(square)), 1e-300)) ** 2
    for _ in range(PASSES):
        square = np.sum(_refitted_residuals(seen, weight) ** 2, axis=1) / NUMBERS
        usual = float(np.median(square[~far])) * NUMBERS / float(chi2.median(NUMBERS))
        now = square > FAR * usual
        if now.mean() > MOST:
            return np.zeros(len(far), dtype=bool)
        if np.array_equal(now, far) and np.array_equal(weight, ~far):
            break
        far, weight = now, np.asarray(~now, dtype=np.float64)
    return far


def _refitted_residuals(seen: ViewResiduals, weight: Floats | Bools) -> Floats:
    """What is left (K, 6) of all views where the parameters follow those of some ``weight (K,)``."""
    A = seen.A.reshape(-1, seen.A.shape[2])
    weighed = A * np.repeat(np.asarray(weight, dtype=np.float64), NUMBERS)[:, None]
    step = np.linalg.solve(weighed.T @ A + np.eye(A.shape[1]), weighed.T @ seen.r.reshape(-1))
    return np.asarray(seen.r - seen.A @ step)


def sizes(seen: ViewResiduals, used: Bools) -> Floats:
    """How far (K,) m each view is from where those ``used`` put the tool."""
    left = (seen.place @ _refitted_residuals(seen, used)[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.norm(left, axis=1))


def astray_views(seen: ViewResiduals, far: Bools, numbers: Ints) -> Iterator[dict[str, Any]]:
    """The warning ``views_astray``; ``numbers (N,)`` are those of the fitted rows among the ones given, from 0."""
    if not far.any():
        return
    size = mm(sizes(seen, ~far))
    rows, off_mm = (numbers[seen.rows[far]] + 1).tolist(), size[far].tolist()
    yield {
        "code": "views_astray",
        "rows": rows,
        "off_mm": off_mm,
        "message": f"Rows {rows_off(rows, off_mm)} are far from where the others put the tool, which are off by "
        f"{float(np.median(size[~far])):.2g} mm (median): joints of another picture, an arm that moved, or corners that are "
        "wrong. Look at these pictures, correct their joints or leave these rows out, and identify again.",
    }


def rows_off(rows: Sequence[int], off_mm: Sequence[float]) -> str:
    """The first of some rows, each with how far off it is, and how many more there are."""
    listed = ", ".join(f"{row} ({one:.3g} mm)" for row, one in list(zip(rows, off_mm, strict=True))[:LISTED])
    return listed if len(rows) <= LISTED else f"{listed} and {len(rows) - LISTED} more"
