"""Visits: rows taken without leaving a pose, averaged; and samples of trajectories, thinned.

With 5 ms correlation a naive test on 4600 Hz samples false-alarms 99 %. Residuals are averaged over windows, the
window's middle row represents it, what correlation is left inflates the noise, and blocks of ten correlation times are
the poses of every permutation and fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.identify.measured_rows import with_sides_of_repeats
from kilter_core.observations import Observations
from kilter_core.observations.groups import segments
from kilter_core.observations.repeats import group_means
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Visits:
    """Averaged rows. ``visit (N,)`` is the visit of each row, ``count (V,)`` its rows, ``pose (V,)`` its pose,
    ``condition (V,)`` numbers pose together with direction, load and session: visits that should agree.
    """

    observations: Observations
    visit: Ints
    count: Ints
    pose: Ints
    condition: Ints

    def __len__(self) -> int:
        return len(self.count)


def average_visits(rows: Observations) -> Visits:
    """Average the rows of each visit, and number visits by their first rows."""
    rows = with_sides_of_repeats(rows)
    first, visit, count = _number_runs(rows.visits())
    averaged = rows.select(first) if count.max() == 1 else _average_rows(rows, visit, first, count)
    return Visits(averaged, visit, count, rows.pose_groups()[first], rows.conditions()[first])


def isolate_unused_visits(condition: Ints, used: Bools) -> Ints:
    """Conditions (V,) where visits that are not ``used (V,)`` repeat none."""
    return np.where(used, condition, condition.max() + 1 + np.arange(len(used)))


def _number_runs(run: Ints) -> tuple[Ints, Ints, Ints]:
    """First row (V,) of each run, the number (N,) of its run of every row in the order of the rows, and its rows (V,)."""
    _, first, inverse, count = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return first[order].astype(np.int64), place[inverse.reshape(-1)], count[order].astype(np.int64)


def _average_rows(rows: Observations, visit: Ints, first: Ints, count: Ints) -> Observations:
    out = rows.select(first)
    plain = (
        "q",
        "position",
        "markers",
        "link_q",
        "tilt",
        "qd",
        "qdd",
        "tau",
        "t",
        "temperature_c",
        "bar_length",
        "base_tilt_x",
        "base_tilt_y",
        "link_mass",
        "link_wrench",
        "command",
    )
    made: dict[str, Any] = {
        name: group_means(value, visit) for name in plain if (value := getattr(rows, name)) is not None
    }
    if rows.rotation is not None:
        mean = group_means(rows.rotation, visit)
        made["rotation"] = np.stack([nearest_rotation(R) if k > 1 else R for R, k in zip(mean, count, strict=True)])
    if rows.sigma is not None:
        made["sigma"] = np.sqrt(group_means(rows.sigma**2, visit) / count[:, None])
    return replace(out, **made)


MOST_WINDOWS = 6000
BLOCK = 10.0  # correlation times
FEWEST_BLOCKS = 30


@dataclass(frozen=True)
class Windows:
    """Windows of a motion: ``middle (V,)`` rows that represent them and ``window (N,)`` of every row."""

    middle: Ints
    window: Ints
    width: int = 1


def split_into_windows(rows: Observations, width: int | None = None) -> Windows:
    """Equal windows of ``width`` rows, or so many rows that there are 6000 of them at most; none spans two motions."""
    width = width or max(1, -(-len(rows) // MOST_WINDOWS))
    motion = segments(rows)
    place = np.arange(len(rows)) - np.searchsorted(motion, motion)
    first = (place % width == 0) | (np.diff(motion, prepend=-1) > 0)
    window = np.cumsum(first).astype(np.int64) - 1
    starts = np.flatnonzero(first)
    ends = np.r_[starts[1:], len(rows)]
    return Windows(((starts + ends - 1) // 2).astype(np.int64), window, width)


def average_windows(rows: Observations, residual: Floats, windows: Windows, live: Bools) -> Observations:
    """Middle rows whose position is moved by the mean of their window's residual (N, m) less their own.

    ``live`` are the joints that residuals of link-side encoders belong to. Averaging positions would cut the corners
    of a curve; averaging residuals does not.
    """
    out = rows.select(windows.middle)
    count = np.bincount(windows.window)
    mean = np.stack([np.bincount(windows.window, np.nan_to_num(c)) for c in residual.T], axis=1) / count[:, None]
    shift = mean - np.nan_to_num(residual[windows.middle])
    if rows.link_q is not None and rows.position is None:
        assert out.link_q is not None
        moved = out.link_q.copy()
        moved[:, live] += shift
        return replace(out, link_q=moved)
    return out if out.position is None else replace(out, position=out.position + shift[:, :3])


def correlation_length(residual: Floats) -> float:
    """Integrated autocorrelation (rows) of residuals (V, m) in order, 1 when independent (Geyer's positive sums)."""
    r = residual - residual.mean(axis=0)
    size = 1 << (2 * len(r) - 1).bit_length()
    power = np.abs(np.fft.rfft(r, size, axis=0)) ** 2
    auto = np.fft.irfft(power, size, axis=0)[: len(r) // 2].sum(axis=1)
    if auto[0] <= 0.0:
        return 1.0
    rho = auto / auto[0]
    pairs = rho[: 2 * (len(rho) // 2)].reshape(-1, 2).sum(axis=1)
    stop = int(np.argmax(pairs <= 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return float(max(1.0, 2.0 * np.sum(pairs[:stop]) - 1.0))


def blocks(rows: int, length: float) -> Ints:
    """Block (V,) of each row: ten correlation times, or a thirtieth of the motion if that is shorter."""
    width = int(max(1, min(BLOCK * length, rows / FEWEST_BLOCKS)))
    return np.asarray(np.arange(rows) // width, dtype=np.int64)


def motion_blocks(rows: Observations, length: float) -> Ints:
    """Blocks (V,) of one or more motions; none spans two of them."""
    motion = segments(rows)
    block = blocks(len(rows), length)
    return np.unique(np.stack([motion, block], axis=1), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
