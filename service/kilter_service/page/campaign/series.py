"""A column of very many rows as a line of a few hundred points, of which the extremes are never lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_service.ground.recent import Recent

if TYPE_CHECKING:
    from kilter_core.types import Floats
KEPT_BYTES = 96 << 20  # a dozen columns of a million rows
LEAST, MOST = 50, 4000  # pixels


def thin_series(
    values: Floats, first: int, last: int, width: int, keep: Sequence[int] = ()
) -> tuple[list[int], list[float | None]]:
    """Return rows (from 1) and values to draw of rows ``first`` to ``last``: of each pixel the least and the greatest.

    Where there are fewer rows than two to a pixel, all of them. Rows to ``keep`` are always among them.
    """
    first, last = max(1, first), min(len(values), last)
    part = values[first - 1 : last]
    if len(part) <= 2 * width:
        return list(range(first, first + len(part))), [None if np.isnan(v) else float(v) for v in part]
    edges = np.linspace(0, len(part), width + 1).astype(np.int64)
    starts = edges[:-1]
    low = _places(np.where(np.isnan(part), np.inf, part), starts)
    high = _places(np.where(np.isnan(part), np.inf, -part), starts)
    kept = np.array([row - first for row in keep if first <= row <= last], dtype=np.int64)
    chosen = np.unique(np.concatenate([low, high, kept]))
    return (chosen + first).tolist(), [None if np.isnan(v) else float(v) for v in part[chosen]]


def _places(values: Floats, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The place of the least value between one start and the next."""
    least = np.minimum.reduceat(values, starts)
    lengths = np.diff(np.append(starts, len(values)))
    hits = np.flatnonzero(values == np.repeat(least, lengths))
    owner = np.searchsorted(starts, hits, side="right") - 1
    return hits[np.unique(owner, return_index=True)[1]]


KEPT = Recent["Floats"](KEPT_BYTES, lambda column: column.nbytes)  # of whichever campaigns
