"""Some of many rows, evenly spread."""

from __future__ import annotations

import numpy as np

from kilter_core.types import Ints


def evenly(count: int, most: int) -> Ints:
    """Places of at most so many out of ``count``, shape (min(count, most),), evenly spread from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
