"""Which readings are the same position: decided by the gaps between them, never by rounding."""

from __future__ import annotations

import itertools
from collections.abc import Sequence


def clusters(values: Sequence[float], tolerance: float) -> list[int]:
    """Number the values so that those with no gap above the tolerance between them share a number."""
    labels = [0] * len(values)
    order = sorted(range(len(values)), key=values.__getitem__)
    for before, after in itertools.pairwise(order):
        labels[after] = labels[before] + (values[after] - values[before] > tolerance)
    return labels
