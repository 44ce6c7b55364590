"""Noise of a picture's pixels around a board, in dark and in bright places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see.pictures import Grey

ROUNDING = 12.0**-0.5  # standard deviation that whole grey levels have
KERNEL = np.array([1.0, -2.0, 1.0])  # its square blanks planes and bows, and leaves noise times 6
MOST_PIXELS = 120_000
LEAST_FLAT = 200  # pixels, below which all of the board are taken
STEEP = 4.0  # times the picture's usual slope: an edge


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a pixel in grey levels at two grey levels; the variance is linear in between."""

    dark: float
    bright: float
    dark_level: float
    bright_level: float

    def variance(self, grey: Floats) -> Floats:
        """Variance of pixels of these grey levels."""
        span = max(self.bright_level - self.dark_level, 1.0)
        share = np.clip((grey - self.dark_level) / span, 0.0, 1.0)
        return np.asarray((1.0 - share) * self.dark**2 + share * self.bright**2)


def estimate_noise(grey: Grey, corners: Floats) -> Noise:
    """Noise around corners (n, 2) px: what is left of flat places when planes and bows are taken off."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    part_of = min(
        1.0, (MOST_PIXELS / max(1.0, float(np.prod(high - low)))) ** 0.5
    )  # the middle of a large board is enough
    middle, half = (low + high) / 2, (high - low) / 2 * part_of
    low = np.maximum(np.floor(middle - half).astype(int) - 8, 0)
    high = np.ceil(middle + half).astype(int) + 9
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    if min(part.shape) < 8:
        return Noise(1.0, 1.0, 0.0, 255.0)
    left = _bent(_bent(part, 0), 1) / 6.0
    level, slope = _around(part)
    low_level, high_level = (float(v) for v in np.percentile(level, [10, 90]))
    between = (low_level + high_level) / 2
    sides = [_spread(left, slope, side) for side in (level < between, level >= between)]
    return Noise(sides[0], sides[1], low_level, high_level)


def _bent(part: Floats, axis: int) -> Floats:
    rows = np.moveaxis(part, axis, 0)
    return np.moveaxis(KERNEL[0] * rows[:-2] + KERNEL[1] * rows[1:-1] + KERNEL[2] * rows[2:], 0, axis)


def _around(part: Floats) -> tuple[Floats, Floats]:
    """Mean and range of the 3 x 3 pixels around each."""
    shifted = [part[i : part.shape[0] - 2 + i, k : part.shape[1] - 2 + k] for i in range(3) for k in range(3)]
    stack = np.stack(shifted)
    return np.asarray(stack.mean(axis=0)), np.asarray(np.ptp(stack, axis=0))


def _spread(left: Floats, slope: Floats, side: NDArray[np.bool_]) -> float:
    """Robust standard deviation where it is flat: the half with the smaller range, the range being of noise too."""
    if side.sum() < LEAST_FLAT:
        return ROUNDING
    flat = side & (slope <= STEEP / 2 * np.percentile(slope[side], 30))
    values = np.abs(left[flat if flat.sum() >= LEAST_FLAT else side])
    return max(ROUNDING, float(np.median(values)) / 0.6745)
