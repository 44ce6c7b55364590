"""Markers that change places and columns that move over: as a plain search, frame by frame, finds them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_files.tables.survey import jumps

Floats = NDArray[np.float64]
JUMP_MM, LEFT = 5.0, 0.05


def by_hand(points: Floats, k: int) -> str:
    """What frame ``k + 1`` shows beside the one before it, coordinate by coordinate and pair by pair."""
    old, new = points[k].ravel().tolist(), points[k + 1].ravel().tolist()
    known = sorted(abs(b - a) for a, b in zip(old, new, strict=True) if a == a and b == b)
    middle = len(known) // 2
    size = 0.0 if len(known) < 3 else known[middle] if len(known) % 2 else 0.5 * (known[middle - 1] + known[middle])
    for by in (1, 2, -1, -2) if size >= JUMP_MM else ():
        pairs = [(i - by, i) for i in range(len(new)) if 0 <= i - by < len(old)]
        left = [abs(new[j] - old[i]) for i, j in pairs if old[i] == old[i] and new[j] == new[j]]
        if len(left) >= 2 and max(left) < LEFT * size:
            return f"all columns moved by {by} here"
    starts = [points[k]] + ([2 * points[k] - points[k - 1]] if k else [])
    return next(filter(None, (swap(start, points[k], points[k + 1]) for start in starts)), "")


def swap(start: Floats, before: Floats, after: Floats) -> str:
    jumped = [i for i in range(len(after)) if np.any(np.abs(after[i] - before[i]) > JUMP_MM)]
    for i in jumped if len(jumped) <= 64 else ():
        for j in jumped:
            there = max(np.linalg.norm(after[i] - start[j]), np.linalg.norm(after[j] - start[i]))
            own = min(np.linalg.norm(after[i] - start[i]), np.linalg.norm(after[j] - start[j]))
            if i < j and there < LEFT * own:
                return f"the markers 'M{i}' and 'M{j}' change places here"
    return ""


def recording(rng: np.random.Generator) -> Floats:
    """A body that moves slowly or fast, with markers that change places, columns that move over, and gaps."""
    frames, markers = int(rng.integers(2, 40)), int(rng.choice([1, 2, 4, 7, 70], p=[0.1, 0.2, 0.4, 0.2, 0.1]))
    path = np.cumsum(rng.normal(0.0, rng.choice([0.5, 8.0]), (frames, 1, 3)), axis=0)
    points = path + rng.uniform(-300.0, 300.0, (markers, 3)) + rng.normal(0.0, 0.05, (frames, markers, 3))
    for kind in rng.integers(0, 3, int(rng.integers(0, 4))):
        k = int(rng.integers(0, frames))
        if kind == 0 and markers > 1:
            one, other = rng.choice(markers, 2, replace=False)
            points[k:, [one, other]] = points[k:, [other, one]]
        elif kind == 1:
            flat = points[k:].reshape(frames - k, -1)
            points[k:] = np.roll(flat, int(rng.choice([1, 2, -1, -2])), axis=1).reshape(points[k:].shape)
        else:
            points[k : k + 3, int(rng.integers(0, markers))] = np.nan
    return points


def test_all_frames_at_once_say_what_each_says_by_itself() -> None:
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(60):
        points = recording(rng)
        names = tuple(f"M{i}" for i in range(points.shape[1]))
        each = [(k + 11, by_hand(points, k)) for k in range(len(points) - 1)]
        wanted = [(row, said) for row, said in each if said]
        assert jumps(points, np.arange(len(points)) + 10, names) == wanted
        found += len(wanted)
    assert found > 30
