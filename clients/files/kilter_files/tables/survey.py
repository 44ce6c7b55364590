"""One pass over a recording: gaps, range and noise of each marker, and the places where it cannot be right."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from kilter_files.ground.later import np
from kilter_files.ground.units import SIZES
from kilter_files.tables.recording import Block, Recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kilter_files.ground.arrays import Bools, Floats, Ints

FAR_MM = 30_000.0  # no optical tracker sees markers 30 m away
NEAR_MM = 50.0  # a tracker stands farther away
NOISE_FRAMES = 200_000
NOISE_ORDERS = (2, 4, 6)
NOISE_FEWEST = 6
SHOWN = 5

JUMP_MM = 5.0
SHIFT_SHARE = 0.05  # a jump is explained by moved columns when this little of it is left
SHIFTS = (1, 2, -1, -2)
MOST_MOVED = 64  # markers that jump at once, among which pairs are looked for
PAIRS_AT_ONCE = 100_000


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


def jumps(points: Floats, rows: Ints, names: tuple[str, ...]) -> list[tuple[int, str]]:
    """Return the rows where markers changed places, or where all columns moved over by some."""
    step = np.abs(np.diff(points, axis=0))
    with np.errstate(invalid="ignore"):
        moved = np.where(np.isnan(step), 0.0, step).max(axis=2) > JUMP_MM
    found: list[tuple[int, str]] = []
    for part in _split_steps(np.flatnonzero(moved.any(axis=1)), moved):
        before, after = points[part], points[part + 1]
        shifted, pair = _column_shifts(before, after), _swapped_marker_pairs(before, after, moved[part])
        # In fast motion a marker is nearer to where it was going than to where it was.
        coming = np.where((part > 0)[:, None, None], 2.0 * before - points[part - 1], np.nan)
        later = _swapped_marker_pairs(coming, after, moved[part])
        pair = np.where(pair[:, :1] < 0, later, pair)
        for row, by, (one, other) in zip(rows[part + 1].tolist(), shifted.tolist(), pair.tolist(), strict=True):
            if by:
                found.append((row, f"all columns moved by {by} here"))
            elif one >= 0:
                found.append((row, f"the markers {names[one]!r} and {names[other]!r} change places here"))
    return found


def _split_steps(at: Ints, moved: Bools) -> Iterator[Ints]:
    """Steps in parts that are small however many markers there are."""
    size = min(moved.shape[1], MOST_MOVED)
    count = max(1, PAIRS_AT_ONCE // max(1, size * size))
    for first in range(0, len(at), count):
        yield at[first : first + count]


def _column_shifts(before: Floats, after: Floats) -> Ints:
    """By how many columns all of them moved over in each step (n,), 0 where they did not."""
    old, new = before.reshape(len(before), -1), after.reshape(len(after), -1)
    size = _median(np.abs(new - old))
    found = np.zeros(len(old), dtype=np.int64)
    for by in SHIFTS:
        left = np.abs(new[:, by:] - old[:, :-by]) if by > 0 else np.abs(new[:, :by] - old[:, -by:])
        known = ~np.isnan(left)
        enough = (known.sum(axis=1) >= 2) & (size >= JUMP_MM)
        most = np.where(known, left, -np.inf).max(axis=1, initial=-np.inf)
        found[(found == 0) & enough & (most < SHIFT_SHARE * size)] = by
    return found


def _median(values: Floats) -> Floats:
    """Median (n,) of what is known in each row, NaN of fewer than three."""
    ordered = np.sort(values, axis=1)  # NaN come last
    count = (~np.isnan(values)).sum(axis=1)
    each, last = np.arange(len(values)), np.maximum(count, 1)
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    middle = 0.5 * (ordered[each, (last - 1) // 2] + ordered[each, last // 2])
    return np.where(count < 3, np.nan, middle)


def _swapped_marker_pairs(before: Floats, after: Floats, moved: Bools) -> Ints:
    """The first two markers (n, 2) of each step that change places, -1 where there are none."""
    count = moved.sum(axis=1)
    most = min(int(count.max(initial=0)), MOST_MOVED)
    none = np.full((len(before), 2), -1, dtype=np.int64)
    if most < 2:
        return none
    which = np.argsort(~moved, axis=1, kind="stable")[:, :most]  # those that moved come first, in their order
    real = np.take_along_axis(moved, which, axis=1) & (count <= MOST_MOVED)[:, None]
    new, old = (np.take_along_axis(points, which[..., None], axis=1) for points in (after, before))
    apart = np.linalg.norm(new[:, :, None] - old[:, None], axis=-1)
    own = np.diagonal(apart, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        crossed = np.maximum(apart, apart.transpose(0, 2, 1)) < SHIFT_SHARE * np.minimum(own[:, :, None], own[:, None])
    crossed &= real[:, :, None] & real[:, None] & np.triu(np.ones((most, most), dtype=bool), 1)
    flat = crossed.reshape(len(before), -1)
    first, second = np.divmod(flat.argmax(axis=1), most)
    each = np.arange(len(before))
    pairs = np.stack([which[each, first], which[each, second]], axis=1)
    return np.where(flat.any(axis=1)[:, None], pairs, none)
