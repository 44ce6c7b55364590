"""What is left of values when each group's mean is taken out: repeats of a condition, shots of a visit."""

from __future__ import annotations

import math

import numpy as np

from kilter_core.types import Bools, Floats, Ints


def subtract_group_means(values: Floats, group: Ints, kept: Bools | None = None) -> Floats:
    """Values (V, ...) less the mean of their group (V,), taken over those ``kept (V,)``, all of them when None."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    rows, groups = (flat, group) if kept is None else (flat[kept], group[kept])
    size = int(group.max(initial=-1)) + 1
    count = np.maximum(np.bincount(groups, minlength=size), 1)
    means = np.stack([np.bincount(groups, c, minlength=size) for c in rows.T], axis=1) / count[:, None]
    return np.asarray((flat - means[group]).reshape(values.shape))


def unbiased_deviations(values: Floats, group: Ints, kept: Bools) -> tuple[Floats, Floats]:
    """Values (V, m) less the mean that those ``kept (V,)`` have in their group, and the factor (V, 1) they grow by.

    A mean of n values is pulled towards each of them: deviations times the factor have the variance of the values.
    """
    count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
    factor = np.sqrt(np.maximum(count, 2) / np.maximum(count - 1, 1))[group][:, None]
    return subtract_group_means(values, group, kept) * factor, factor


def evenly(count: int, most: int) -> Ints:
    """Places of at most so many out of ``count``, shape (min(count, most),), evenly spread from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
