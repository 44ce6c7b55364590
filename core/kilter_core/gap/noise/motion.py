"""Trajectories (E10): samples of a motion are not independent, and there are too many of them.

With 5 ms correlation a naive test on 4600 Hz samples false-alarms 99 %. Residuals are averaged over windows, the
window's middle row represents it, what correlation is left inflates the noise, and blocks of ten correlation times are
the poses of every permutation and fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.identify.holdout import split
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

FEWEST_ROWS = 300
MOST_WINDOWS = 6000
BLOCK = 10.0  # correlation times
FEWEST_BLOCKS = 30
SMOOTH = 0.02  # step from row to row over the whole spread, below which rows are one motion
UNEXPLAINED = 0.25  # share of the squared steps that speeds may leave unexplained


@dataclass(frozen=True)
class Windows:
    """Windows of a motion: ``middle (V,)`` rows that represent them and ``window (N,)`` of every row."""

    middle: Ints
    window: Ints
    width: int = 1


def is_trajectory(rows: Observations) -> bool:
    """Whether the rows are samples of motions: many, timed, unrepeated, and each follows from the one before.

    With speeds, those must explain the steps. Without, steps must be small: poses of a fine grid look much the same.
    """
    if len(rows) < FEWEST_ROWS or rows.t is None or rows.pose_id is not None:
        return False
    step = np.diff(rows.q, axis=0)
    if rows.qd is not None:
        on = np.diff(segments(rows)) == 0
        foreseen = 0.5 * (rows.qd[1:] + rows.qd[:-1]) * np.diff(rows.t)[:, None]
        size = float(np.sum(step[on] ** 2))
        return size > 0.0 and float(np.sum((step - foreseen)[on] ** 2)) < UNEXPLAINED * size
    spread = float(np.linalg.norm(np.std(rows.q, axis=0)))
    return bool(np.median(np.linalg.norm(step, axis=1)) < SMOOTH * spread)


def windows_of(rows: Observations, width: int | None = None) -> Windows:
    """Equal windows of ``width`` rows, or so many rows that there are 6000 of them at most; none spans two motions."""
    width = width or max(1, -(-len(rows) // MOST_WINDOWS))
    motion = segments(rows)
    place = np.arange(len(rows)) - np.searchsorted(motion, motion)
    first = (place % width == 0) | (np.diff(motion, prepend=-1) > 0)
    window = np.cumsum(first).astype(np.int64) - 1
    starts = np.flatnonzero(first)
    ends = np.r_[starts[1:], len(rows)]
    return Windows(((starts + ends - 1) // 2).astype(np.int64), window, width)


def averaged(rows: Observations, residual: Floats, windows: Windows, live: Bools) -> Observations:
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


def segments(rows: Observations) -> Ints:
    """Number the motions (V,): a new one wherever the session changes or time starts again."""
    new = np.zeros(len(rows), dtype=bool)
    if rows.session is not None:
        new[1:] |= rows.session[1:] != rows.session[:-1]
    if rows.t is not None:
        new[1:] |= rows.t[1:] < rows.t[:-1]
    return np.asarray(np.cumsum(new), dtype=np.int64)


def blocks(rows: int, length: float) -> Ints:
    """Block (V,) of each row: ten correlation times, or a thirtieth of the motion if that is shorter."""
    width = int(max(1, min(BLOCK * length, rows / FEWEST_BLOCKS)))
    return np.asarray(np.arange(rows) // width, dtype=np.int64)


def motion_blocks(rows: Observations, length: float) -> Ints:
    """Blocks (V,) of one or more motions; none spans two of them."""
    motion = segments(rows)
    block = blocks(len(rows), length)
    return np.unique(np.stack([motion, block], axis=1), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def hold_out(rows: Observations, fraction: float, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out): whole poses; of motions whole motions, or the last part of a single one.

    Neighbouring samples of a motion are the same measurement twice: held out at random they would prove nothing.

    Raises:
        OptionError: a fraction outside (0, 1). TooFewPosesError: a side without poses.

    """
    if not is_trajectory(rows):
        return split(rows, fraction, seed)
    if not 0.0 < fraction < 1.0:
        raise OptionError(f"validation is {fraction}: give a fraction between 0 and 1.", option="validation")
    motion = segments(rows)
    count = int(motion.max()) + 1
    if count == 1:
        held = np.arange(len(rows)) >= round((1.0 - fraction) * len(rows))
    else:
        out = np.random.default_rng(seed).permutation(count)[: min(max(1, round(fraction * count)), count - 1)]
        held = np.isin(motion, out)
    return np.flatnonzero(~held), np.flatnonzero(held)
