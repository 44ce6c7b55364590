"""Where columns of a recording cannot be right: markers that change places, columns that all move over by some."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kilter_files.ground.arrays import Bools, Floats, Ints

JUMP_MM = 5.0
SHIFT_SHARE = 0.05  # a jump is explained by moved columns when this little of it is left
SHIFTS = (1, 2, -1, -2)
MOST_MOVED = 64  # markers that jump at once, among which pairs are looked for
PAIRS_AT_ONCE = 100_000


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
