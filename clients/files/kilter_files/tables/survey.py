"""One pass over a recording: gaps, range and noise of each marker, and the places where it cannot be right."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.units import SIZES
from kilter_files.tables.jumps import jumps
from kilter_files.tables.recording import Block, Recording

FAR_MM = 30_000.0  # no optical tracker sees markers 30 m away
NEAR_MM = 50.0  # a tracker stands farther away
NOISE_FRAMES = 200_000
NOISE_ORDERS = (2, 4, 6)
NOISE_FEWEST = 6
SHOWN = 5


@dataclass
class Survey:
    """What was found; ``faults`` are rows that cannot be measurements, ``doubts`` are worth a look."""

    frames: int = 0
    seen: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    low: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    high: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    noise_mm: Floats = field(default_factory=lambda: np.zeros(0))
    longest_gap: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    empty_frames: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)


def survey(recording: Recording) -> Survey:
    """Read a recording once, block by block."""
    count = len(recording.markers)
    found = Survey(
        seen=np.zeros(count, np.int64),
        low=np.full((count, 3), np.inf),
        high=np.full((count, 3), -np.inf),
        longest_gap=np.zeros(count, np.int64),
    )
    before: Block | None = None
    open_gap = np.zeros(count, np.int64)
    for block in recording.blocks():
        _ranges(found, block)
        open_gap = _gaps(found, block, open_gap)
        if before is None:
            found.noise_mm = noise(block.points_mm[:NOISE_FRAMES])
        joined = block.points_mm if before is None else np.concatenate([before.points_mm[-1:], block.points_mm])
        rows = block.rows if before is None else np.concatenate([before.rows[-1:], block.rows])
        found.faults += jumps(joined, rows, recording.markers)
        before = block
    _doubts(found, recording)
    return found


def noise(points: Floats) -> Floats:
    """Return each marker's standard deviation of a coordinate, mm: the root mean square of those of x, y and z.

    Differences of neighbouring frames leave smooth motion alone, the higher the order the faster; the least of the
    orders is taken, for motion only adds.
    """
    if len(points) < 8:
        return np.full(points.shape[1], np.nan)
    found = []
    for order in NOISE_ORDERS:
        size = math.sqrt(math.comb(2 * order, order))
        found.append(
            np.array([_spread(d) / size for d in np.diff(points, order, axis=0).reshape(-1, points[0].size).T])
        )
    least = np.fmin.reduce(found).reshape(points.shape[1:])
    return np.asarray(np.sqrt(np.mean(least**2, axis=1)))


def _spread(values: Floats) -> float:
    """Standard deviation about zero without outliers; NaN of fewer than ``NOISE_FEWEST`` values."""
    size = np.abs(values[~np.isnan(values)])
    if len(size) < NOISE_FEWEST:
        return float("nan")
    # The median alone would show the steps of rounded coordinates; nine tenths still do not see the outliers.
    low, high = np.quantile(size, [0.5, 0.9]) / [0.6745, 1.6449]
    sigma = float(max(low, min(high, 2 * low) if low > 0 else high))
    for _ in range(3):
        sigma = float(np.sqrt(np.mean(size[size <= 4 * sigma] ** 2)))
    return sigma


def _ranges(found: Survey, block: Block) -> None:
    seen = ~np.isnan(block.points_mm[..., 0])
    found.frames += len(block)
    found.seen += seen.sum(axis=0)
    found.empty_frames += int((~seen.any(axis=1)).sum())
    filled = np.where(seen[..., None], block.points_mm, np.inf)
    found.low = np.minimum(found.low, filled.min(axis=0, initial=np.inf))
    found.high = np.maximum(found.high, np.where(np.isinf(filled), -np.inf, filled).max(axis=0, initial=-np.inf))


def _gaps(found: Survey, block: Block, open_gap: NDArray[np.int64]) -> NDArray[np.int64]:
    """Remember each marker's longest gap; return how long each is out of sight at the block's end."""
    for marker, seen in enumerate(~np.isnan(block.points_mm[..., 0]).T):
        at = np.flatnonzero(seen)
        if not len(at):
            open_gap[marker] += len(seen)
            longest = open_gap[marker]
        else:
            inner = int(np.diff(at).max() - 1) if len(at) > 1 else 0
            longest = max(open_gap[marker] + at[0], inner, len(seen) - 1 - at[-1])
            open_gap[marker] = len(seen) - 1 - at[-1]
        found.longest_gap[marker] = max(found.longest_gap[marker], longest)
    return open_gap


def _doubts(found: Survey, recording: Recording) -> None:
    never = [name for name, seen in zip(recording.markers, found.seen, strict=True) if not seen]
    if never:
        found.doubts.append(f"never seen: {', '.join(never[:SHOWN])}{' ...' if len(never) > SHOWN else ''}")
    seen = found.seen > 0
    if seen.any():
        largest = float(max(np.abs(found.low[seen]).max(), np.abs(found.high[seen]).max()))
        spread = float((found.high[seen] - found.low[seen]).max())
        if largest > FAR_MM:
            said = "" if recording.unit == "mm" else f", declared as {recording.unit}"
            likely = "mm" if recording.unit != "mm" else "um"
            factor = SIZES["length"][recording.unit] / SIZES["length"][likely]
            found.doubts.append(
                f"coordinates up to {largest:.6g} mm{said}, and no tracker sees so far: they look like {likely}, {factor:g} "
                f"times smaller (--unit {likely})"
            )
        if largest < NEAR_MM and spread < NEAR_MM:
            said = "" if recording.unit == "mm" else f", declared as {recording.unit}"
            found.doubts.append(
                f"no coordinate is beyond {largest:.3g} mm{said}, and no tracker measures so near: they look like metres, "
                "1000 times larger (--unit m), or inches, 25.4 times (--unit inch)"
            )
        still = [
            n
            for n, low, high, s in zip(recording.markers, found.low, found.high, seen, strict=True)
            if s and np.array_equal(low, high) and recording.frames > 10
        ]
        if still:
            found.doubts.append(f"not one digit changes: {', '.join(still[:SHOWN])}")
