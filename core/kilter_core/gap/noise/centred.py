"""What is left of values when each group's mean is taken out: repeats of a condition, or visits of a block."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def centred(values: Floats, group: Ints, kept: Bools | None = None) -> Floats:
    """Values (V, ...) less the mean of their group (V,), taken over those ``kept (V,)``, all of them when None."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    rows, groups = (flat, group) if kept is None else (flat[kept], group[kept])
    size = int(group.max(initial=-1)) + 1
    count = np.maximum(np.bincount(groups, minlength=size), 1)
    means = np.stack([np.bincount(groups, c, minlength=size) for c in rows.T], axis=1) / count[:, None]
    return np.asarray((flat - means[group]).reshape(values.shape))
