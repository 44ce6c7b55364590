"""Rows that miss a prediction by far more than it expects and than the others do: they are to be looked at, one by one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.stats import norm

from kilter_core.parameters import mm
from kilter_core.types import Floats, Ints

CHANCE = 1e-3  # of naming any row where all are as expected
SIGMAS = 1.96  # half width of a 95 % interval
UNLIKE = 7.0  # times the median of all rows, below which a row is like the others
LISTED = 20


def far_off(error: Floats, u95: Floats) -> tuple[Ints, Floats]:
    """Rows of ``error (N, 3)`` m that are far off, from 0, the worst first, and their largest coordinates (K,) in sigmas.

    A row is far off where its largest coordinate is so in the half widths ``u95 (N, 3)`` m of 95 % intervals, by Bonferroni
    over all coordinates, whose correlation does not matter then. It must be unlike the others as well: where an arm has moved,
    all rows miss by more than was expected, and none of them is wrong.
    """
    with np.errstate(invalid="ignore"):
        sigmas = np.max(SIGMAS * np.abs(error) / u95, axis=1)
    seen = np.isfinite(sigmas)
    if not seen.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    chance = float(norm.isf(CHANCE / (2.0 * 3.0 * np.count_nonzero(seen))))
    limit = max(chance, UNLIKE * float(np.median(sigmas[seen])))
    rows = np.flatnonzero(seen & (np.where(seen, sigmas, 0.0) > limit))
    rows = rows[np.argsort(-sigmas[rows], kind="stable")]
    return rows, sigmas[rows]


def warning(error: Floats, u95: Floats | None) -> Iterator[dict[str, Any]]:
    """Name the rows that are far off; nothing where none is, or nobody knows what was to be expected."""
    rows, sigmas = (np.zeros(0, dtype=np.int64), np.zeros(0)) if u95 is None else far_off(error, u95)
    if not len(rows):
        return
    sizes = np.linalg.norm(error, axis=1)
    off_mm = [mm(one) for one in sizes[rows]]
    others = np.delete(sizes, rows)
    most = mm(float(np.nanmedian(others)))
    named = [f"{row + 1} ({off:.3g} mm, {far:.2g} sigma)" for row, off, far in zip(rows, off_mm, sigmas, strict=True)]
    more = f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
    yield {
        "code": "rows_far_off", "rows": (rows + 1).tolist(), "off_mm": off_mm, "sigmas": sigmas.tolist(),
        "message": f"{'Row' if len(rows) == 1 else 'Rows'} {', '.join(named[:LISTED])}{more} miss the prediction by far more "
        f"than is expected there; of the others the median misses by {most:.2g} mm. Look at their joints and positions. Where "
        "they are wrong, send the other rows as a campaign of their own, and retire this one.",
    }  # fmt: skip
