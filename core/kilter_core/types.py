"""Types that all rooms share: arrays, whose shapes docstrings state, and the callback that hears of progress."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Progress = Callable[[float, str], None]
"""Hears the share done (0 to 1) and the stage in words; it may raise to cancel."""


def unheard(fraction: float, stage: str) -> None:
    """Ignore the progress."""
