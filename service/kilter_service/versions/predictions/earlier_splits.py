"""How earlier releases drew held-out poses: by the order of the rows, each kind of job in a way of its own.

Their versions were fitted to the rest, so what they were fitted to stays told as it was.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.observations import is_trajectory, segments
from kilter_core.types import Ints
from kilter_service.ground.core import core_measurement
from kilter_service.versions.store import Training

if TYPE_CHECKING:
    from kilter_core.observations import Observations


def fitted_by_order(rows: Observations, fraction: float, training: Training) -> Ints:
    """Indices of the rows that a job of an earlier release fitted when a fraction was held out."""
    search, placed = training.kind == "gap", core_measurement.placements(rows)
    if search and is_trajectory(rows):
        held = _of_motions(rows, fraction, training.seed)
    elif search and training.unasked and placed is None:
        held = _evenly(rows, fraction, training.seed)
    else:
        groups, few = (rows.pose_groups(), False) if placed is None else (placed[0], True)
        held = np.isin(groups, _drawn(int(groups.max()) + 1, fraction, training.seed, few))
    return np.flatnonzero(~held)


def _drawn(count: int, fraction: float, seed: int, few: bool) -> Ints:
    """Numbers that were held out of so many; of a few at least one."""
    held = round(fraction * count)
    held = min(max(held, 1), count - 1) if few else held
    return np.random.default_rng(seed).permutation(count)[:held]


def _evenly(rows: Observations, share: float, seed: int) -> NDArray[np.bool_]:
    groups = rows.pose_groups()
    again = np.bincount(groups) > 1
    rng = np.random.default_rng(seed)
    held = [rng.permutation(np.flatnonzero(kind))[: int(share * np.sum(kind))] for kind in (again, ~again)]
    return np.isin(groups, np.concatenate(held))


def _of_motions(rows: Observations, fraction: float, seed: int) -> NDArray[np.bool_]:
    motion = segments(rows)
    count = int(motion.max()) + 1
    if count == 1:
        return np.asarray(np.arange(len(rows)) >= round((1.0 - fraction) * len(rows)))
    return np.isin(motion, _drawn(count, fraction, seed, few=True))
