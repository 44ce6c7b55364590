"""What is refused of two clocks: jumps against each other, a drift no clock has, a motion the model does not explain."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.match.dwells import Thinned, mean_seen
from kilter_files.match.lag_evidence import (
    GRID_S,
    REACH_S,
    Frames,
    Registration,
    Window,
    best_windows,
    likeness,
    register_again,
    sample_frames,
    spread,
    squares_by_model,
    squares_by_speed,
)
from kilter_files.match.rigid_body import Arm
from kilter_files.tables.table import JointLog

STEP_SHARE = 0.25  # of the price of a jump, for one step of the grid: clocks that drift apart take one now and then


@dataclass(frozen=True)
class Stretch:
    """Chunks ``first`` to ``last`` (both in it) have lag number ``lag``."""

    first: int
    last: int
    lag: int


def cheapest(cost: Floats, jump_price: float) -> NDArray[np.int64]:
    """Return the lag number of every chunk of ``cost`` (chunks, lags) along the cheapest path (Viterbi)."""
    step_price = STEP_SHARE * jump_price
    total = cost[0].astype(np.float64)
    came = np.zeros(cost.shape, dtype=np.int32)
    here = np.arange(cost.shape[1], dtype=np.int32)
    for k in range(1, len(cost)):
        low = int(np.argmin(total))
        best, source = total.copy(), here.copy()
        for shift in (-1, 1):
            near = np.full_like(total, np.inf)
            near[max(0, shift) : len(total) + min(0, shift)] = total[max(0, -shift) : len(total) - max(0, shift)]
            better = near + step_price < best
            best, source = np.where(better, near + step_price, best), np.where(better, here - shift, source)
        jumped = total[low] + jump_price < best
        best, source = np.where(jumped, total[low] + jump_price, best), np.where(jumped, low, source)
        came[k], total = source, best + cost[k]
    path = np.empty(len(cost), dtype=np.int64)
    path[-1] = int(np.argmin(total))
    for k in range(len(cost) - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


def stretches(path: NDArray[np.int64], near: int, chunks: int) -> list[Stretch]:
    """Cut a path where it changes by more than ``near`` within ``chunks`` chunks; slow drift stays one stretch."""
    cuts, k = [0], 1
    while k < len(path):
        after = path[k : k + chunks]
        moved = np.abs(after - path[k - 1])
        if path[k] != path[k - 1] and moved.max(initial=0) > near:
            # the change is over where the path has come to where it goes
            far = k + int(np.argmax(moved))
            cuts.append(k + int(np.argmax(np.abs(np.diff(path[k - 1 : far + 1])))))
            k = far + 1
        else:
            k += 1
    edges = [*cuts, len(path)]
    return [Stretch(a, b - 1, int(np.median(path[a:b]))) for a, b in pairwise(edges) if b > a]


CHUNK_FRAMES = 4
EXPLAINED = 0.06  # of the markers' spread that a model may leave where it explains them
CAP = 25.0
FITS = 4.0
MOSTLY = 0.6  # of a part's moments must be explained, or it is none: something was lost there
MODEL_PRICE, SPEED_PRICE = 8.0, 60.0
NEAR_STEPS = 2
NEAR_S = 3.0
LEAST_PART_S = 5.0  # between two jumps; less is what was lost at one
LEAST_JUMP_S = 0.05
LEAST_MM = 0.5
LEAST_UNLIKE = 0.05  # squares of speeds at size one: no two are more alike
FAR = 4.5  # times the scale, and at least this share of the markers' spread: somewhere else
LOST_SHARE = 0.015
LEAST_LOST_S = 1.0
ROUNDS = 3


class Jump(NamedTuple):
    """Between two times of the recording, log time - recording time becomes ``size_s`` more."""

    from_s: float
    to_s: float
    size_s: float


@dataclass(frozen=True)
class LagPath:
    """Parts of the recording (start, end, lag; s) with the jumps between them.

    ``drift`` is how fast the lag grows in the longest part, to ``drift_sigma``. With a model: the share of the markers'
    spread that it leaves at best (``left``), its registration (None when it explains nothing), and the times (start, end)
    that no lag explains (``lost``).
    """

    parts: list[tuple[float, float, float]]
    jumps: list[Jump]
    drift: float = 0.0
    drift_sigma: float = 0.0
    left: float | None = None
    found: Registration | None = None
    lost: tuple[tuple[float, float], ...] = ()


def lag_path(thinned: Thinned, log: JointLog, arm: Arm | None) -> LagPath:
    """Return the lags of a recording: one, unless the clocks jump."""
    frames = sample_frames(thinned, log, arm)
    if arm is not None:
        return _by_model(thinned, log, frames)
    lag = frames.snap_lag_to_grid(likeness(thinned, log).best_s)
    squares = squares_by_speed(thinned, log, frames, lag)
    usual = float(np.nan_to_num(mean_seen(squares, 0)[squares.shape[1] // 2], nan=1.0))
    followed = _follow_cheapest_lag(frames, squares / max(usual, LEAST_UNLIKE), lag, SPEED_PRICE)
    return LagPath(*_parts_and_jumps(frames, followed, lag), *_drift(frames, followed))


def _by_model(thinned: Thinned, log: JointLog, frames: Frames) -> LagPath:
    left = 1.0
    for window in best_windows(thinned, log, frames):
        left = min(left, window.share)
        found = _by_window(frames, window) if window.share < EXPLAINED else None
        if found is not None:
            return found
    lag = likeness(thinned, log).best_s
    return LagPath([(float(frames.t_s[0]), float(frames.t_s[-1]), lag)], [], left=left)


def _by_window(frames: Frames, window: Window) -> LagPath | None:
    """Follow the lags by the registration of a window; None when it explains hardly more than that."""
    found, lag, size = window.found, frames.snap_lag_to_grid(window.lag_s), spread(frames.points)
    blur = (frames.speeds() * GRID_S / 2)[:, None] ** 2  # what half a step of the grid does
    scale = 4 * window.share * size + LEAST_MM
    for _ in range(ROUNDS):
        squares = squares_by_model(frames, found, lag) / (scale**2 + blur).astype(np.float32)
        followed = _follow_cheapest_lag(frames, squares, lag, MODEL_PRICE)
        found, left = register_again(frames, _lags(frames, followed, lag), found, 5 * scale)
        far = max(FAR * scale, LOST_SHARE * size) / scale
        scale = max(1.5 * left, LEAST_MM)
    own = followed.cost[np.arange(len(followed.path)), followed.path]
    if np.mean(own < FITS) < MOSTLY:
        return None
    parts, jumps = _parts_and_jumps(frames, followed, lag)
    return LagPath(parts, jumps, *_drift(frames, followed), window.share, found, _lost_intervals(frames, followed, far))


class _Followed(NamedTuple):
    """Frames of each chunk, their capped cost (chunks, lags), the path, the stretches of it that hold, and their lags, s."""

    chunks: list[NDArray[np.int64]]
    cost: Floats
    path: NDArray[np.int64]
    squares: Floats
    held: list[Stretch]
    fine_s: list[float]


def _follow_cheapest_lag(frames: Frames, squares: Floats, lag: float, price: float) -> _Followed:
    """Follow the cheapest lag through squares (n, lags), in units of what is usual."""
    middle = squares.shape[1] // 2
    inside = np.flatnonzero(~np.isnan(squares[:, middle]))
    chunks = np.array_split(inside, max(1, len(inside) // CHUNK_FRAMES)) if len(inside) else [np.zeros(1, np.int64)]
    with np.errstate(invalid="ignore"):
        capped = np.where(np.isnan(squares), CAP, np.minimum(squares, CAP))
    cost = np.stack([capped[chunk].mean(axis=0) for chunk in chunks])
    path = cheapest(cost, price)
    own = cost[np.arange(len(path)), path]
    near = max(1, round(NEAR_S / (CHUNK_FRAMES * float(np.median(np.diff(frames.t_s))))))
    cut = stretches(path, NEAR_STEPS, near)
    least = LEAST_PART_S / NEAR_S * near
    held = [
        part
        for part in cut
        if np.mean(own[part.first : part.last + 1] < FITS) > MOSTLY
        and (part.last - part.first > least or part.first == 0 or part.last == len(path) - 1)
    ]
    held = held or [Stretch(0, len(path) - 1, middle)]
    fine = [lag + _fine(squares, chunks, part) * GRID_S - REACH_S for part in held]
    return _Followed(chunks, cost, path, squares, held, fine)


def _lags(frames: Frames, followed: _Followed, lag: float) -> Floats:
    """The lag of every frame, s."""
    out = np.full(len(frames.t_s), lag)
    for part, own in zip(followed.held, followed.fine_s, strict=True):
        out[followed.chunks[part.first][0] :] = own
    return out


def _drift(frames: Frames, followed: _Followed) -> tuple[float, float]:
    """How fast the lag grows in the longest stretch, and how well the grid lets that be known."""
    part = max(followed.held, key=lambda p: p.last - p.first)
    t = np.array([frames.t_s[chunk[0]] for chunk in followed.chunks[part.first : part.last + 1]])
    if len(t) < 3:
        return 0.0, np.inf
    lags = followed.path[part.first : part.last + 1] * GRID_S
    return float(np.polyfit(t - t[0], lags, 1)[0]), 2 * GRID_S / float(t[-1] - t[0])


def _lost_intervals(frames: Frames, followed: _Followed, far: float) -> tuple[tuple[float, float], ...]:
    """Times of a second or more, in the parts, at which no lag brings the markers near where they are seen."""
    path, out = followed.path, []
    at = np.zeros(len(path), bool)
    for part in followed.held:
        for k in range(part.first, part.last + 1):
            rows = followed.chunks[k]
            own = followed.squares[rows, path[k]]
            at[k] = not np.isnan(own).all() and float(np.nanmedian(own)) > far**2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
    for a, b in edges.reshape(-1, 2):
        start, end = float(frames.t_s[followed.chunks[a][0]]), float(frames.t_s[followed.chunks[b - 1][-1]])
        if end - start >= LEAST_LOST_S:
            out.append((start, end))
    return tuple(out)


def _parts_and_jumps(
    frames: Frames, followed: _Followed, lag: float
) -> tuple[list[tuple[float, float, float]], list[Jump]]:
    parts: list[tuple[float, float, float]] = []
    jumps: list[Jump] = []
    chunks = followed.chunks
    for k, part in enumerate(followed.held):
        own = followed.fine_s[k]
        start, end = float(frames.t_s[chunks[part.first][0]]), float(frames.t_s[chunks[part.last][-1]])
        if parts and abs(own - parts[-1][2]) < LEAST_JUMP_S:
            parts[-1] = (parts[-1][0], end, parts[-1][2])
            continue
        if parts:
            low, high = _doubtful(frames, followed, followed.held[k - 1], part)
            jumps.append(Jump(low, high, own - parts[-1][2]))
            parts[-1], start = (parts[-1][0], low, parts[-1][2]), high
        parts.append((start, end, own))
    return parts, jumps


def _fine(squares: Floats, chunks: list[NDArray[np.int64]], part: Stretch) -> float:
    """The lag of a stretch between the steps of the grid: where a parabola through its sums is least."""
    rows = np.concatenate(chunks[part.first : part.last + 1])
    around = np.arange(max(0, part.lag - 4), min(squares.shape[1], part.lag + 5))
    sums = np.nansum(np.minimum(squares[rows][:, around], 4 * CAP), axis=0)
    k = int(np.argmin(sums))
    if 0 < k < len(sums) - 1:
        a, b, c = (float(sums[k + i]) for i in (-1, 0, 1))
        return float(around[k]) + (0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c > 0 else 0.0)
    return float(around[k])


def _doubtful(frames: Frames, followed: _Followed, before: Stretch, after: Stretch) -> tuple[float, float]:
    """The times of the moments about a jump at which both lags fit, or neither: it lies somewhere among them."""
    cost, chunks, low, high = followed.cost, followed.chunks, before.last, after.first
    while low > before.first and _either_way(cost[low], before.lag, after.lag):
        low -= 1
    while high < after.last and _either_way(cost[high], before.lag, after.lag):
        high += 1
    return float(frames.t_s[chunks[low][0]]), float(frames.t_s[chunks[high][-1]])


def _either_way(cost: Floats, before: int, after: int) -> bool:
    return bool((cost[before] < FITS) == (cost[after] < FITS))


LEAST_CORRELATION = 0.3
MOST_DRIFT = 5e-4  # quartz clocks agree within a few hundred parts in a million
SHOWN = 5


@dataclass(frozen=True)
class Checks:
    """What is known to check a pairing by, and what the person allows.

    ``arm`` is the robot's model. ``piecewise``: match the parts between jumps of the clocks each by itself. ``unchecked``:
    what would be refused is a warning. Rows from ``since_s`` to ``until_s`` of the recording count.
    """

    arm: Arm | None = None
    piecewise: bool = False
    unchecked: bool = False
    since_s: float = -float("inf")
    until_s: float = float("inf")

    def refuse(self, path: Path, what: str, remedy: str) -> str:
        """Refuse, or return the warning where the person allows it.

        Raises:
            FileError: what was found is not allowed.

        """
        if not self.unchecked:
            raise fault(path, what, f"{remedy} --unchecked sends it anyway.")
        return what


UNTOLD = Checks()


@dataclass(frozen=True)
class Followed:
    """Parts of a recording (start, end, lag; s) that may be matched, but for what is ``lost``; and warnings.

    ``sure``: the lags are the model's, good to some milliseconds.
    """

    parts: list[tuple[float, float, float]]
    lost: tuple[tuple[float, float], ...]
    correlation: float
    warnings: list[str]
    sure: bool = False


def follow_clocks(path: Path, thinned: Thinned, log: JointLog, checks: Checks) -> Followed:
    """Find the lag between the clocks, and refuse jumps.

    Raises:
        FileError: a motion that is not the log's, or clocks that jump or run apart.

    """
    alike = likeness(thinned, log)
    found = lag_path(thinned, log, checks.arm) if checks.arm is not None else None
    warnings: list[str] = []
    if found is not None and found.found is None:
        warnings.append(_refuse_other_model(path, log, checks, found.left or 1.0))
        found = None
    if found is None:
        if alike.correlation < LEAST_CORRELATION:
            what = f"its motion is not that of {log.path.name}: the speeds correlate by {alike.correlation:.2f} at best"
            raise fault(path, what, "Is it the log of this recording? Do both hold the same motion?")
        found = lag_path(thinned, log, None)
    if found.jumps:
        warnings.append(_refuse_jumps(path, log, found, checks))
    else:
        warnings += refuse_drift(path, log, found.drift, found.drift_sigma, checks)
    warnings += _lost_interval_warnings(found)
    return Followed(found.parts, found.lost, alike.correlation, warnings, found.found is not None)


def _refuse_other_model(path: Path, log: JointLog, checks: Checks, left: float) -> str:
    assert checks.arm is not None
    what = (
        f"the model of {checks.arm.name} explains no part of it with the joints of {log.path.name}: "
        f"{left:.0%} of the markers' motion is left at best"
    )
    remedy = (
        "Is it the log of this recording, the robot that was measured, and are the joints in its order and direction?"
    )
    return checks.refuse(path, what, remedy)


def refuse_drift(path: Path, log: JointLog, drift: float, sigma: float, checks: Checks) -> list[str]:
    """Refuse a drift that no clock has; a warning where the person allows it.

    Raises:
        FileError: the clocks drift apart by more than 500 ppm, beyond three standard deviations.

    """
    if not abs(drift) - 3 * sigma > MOST_DRIFT:
        return []
    what = (
        f"its clock and that of {log.path.name} drift apart by {drift * 1e6:+.0f} ppm (± {sigma * 1e6:.0f}); clocks agree "
        f"within a few hundred, {MOST_DRIFT * 1e6:.0f} is the limit"
    )
    return [checks.refuse(path, what, "Is the frame rate right (--rate), and t_s of the log in seconds?")]


def describe_jump(jump: Jump) -> str:
    """Say a jump in words."""
    return f"by {jump.size_s:+.2f} s between {jump.from_s:.2f} and {jump.to_s:.2f} s"


def _refuse_jumps(path: Path, log: JointLog, found: LagPath, checks: Checks) -> str:
    named = "; ".join(describe_jump(jump) for jump in found.jumps[:SHOWN]) + (
        " ..." if len(found.jumps) > SHOWN else ""
    )
    what = f"its clock and that of {log.path.name} jump against each other {named}"
    if found.found is None:
        what += " (by the speeds alone, so roughly)"
        remedy = (
            "Name the robot (--robot or --model): its model finds time and size, and --piecewise matches the parts."
        )
    elif checks.piecewise:
        return f"{what}: matched part by part"
    else:
        remedy = "Match the parts before and after separately with --piecewise, or one of them with --until or --since."
    if checks.unchecked and found.found is None:
        return checks.refuse(path, what, remedy)
    raise fault(path, what, remedy)


def _lost_interval_warnings(found: LagPath) -> list[str]:
    return [f"from {a:.2f} to {b:.2f} s no lag explains where the markers are: left out" for a, b in found.lost]
