"""Rows that are copies of others, or hold a reading that was not taken again: they repeat a pose and say nothing of noise."""

from __future__ import annotations

import numpy as np

from kilter_core.observations.rows import Observations
from kilter_core.types import Bools

COPY = 1e-9  # m or rad: no instrument repeats itself so exactly
COARSE = 0.05  # share of equal coordinates between repeats from which the instrument rounds: equal rows prove nothing


def identical_repeats(rows: Observations) -> Bools:
    """Rows (N,) that repeat all that was measured in an earlier row of the same pose and conditions, to the last digit."""
    parts = [
        v.reshape(len(rows), -1) for v in (rows.position, rows.rotation, rows.markers, rows.link_q) if v is not None
    ]
    if not parts:
        return np.zeros(len(rows), dtype=bool)
    lattice = np.round(np.nan_to_num(np.hstack(parts), nan=-1.0) / COPY)
    condition = rows.conditions()
    order = np.lexsort((np.arange(len(rows)), condition))
    pairs = condition[order][1:] == condition[order][:-1]
    equal = lattice[order][1:][pairs] == lattice[order][:-1][pairs]
    others = equal[~equal.all(axis=1)]
    if len(others) and float(np.mean(others)) > COARSE:
        return np.zeros(len(rows), dtype=bool)
    first = np.unique(np.hstack([condition[:, None], lattice]), axis=0, return_index=True)[1]
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    return again
