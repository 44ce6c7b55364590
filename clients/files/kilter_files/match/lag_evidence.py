"""How badly each lag between the clocks explains each moment of a recording: by the robot's model, or by speeds alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.match.dwells import Thinned
from kilter_files.match.rigid_body import Arm, rotations
from kilter_files.tables.table import JointLog

NOISE_MM = 0.1
# what the geometry of a robot may be off, as standard deviations: an axis (rad, mm), the wave of a joint (rad)
AXIS_RAD, AXIS_MM, WAVE_RAD = 5e-3, 3.0, 1e-3
ENDED_MM = 1e-3


@dataclass(frozen=True)
class Registration:
    """Device = ``turn`` (base + errors) + ``place``; ``markers`` (m, 3) in the tool's frame; mm.

    ``errors`` are small errors of the arm, a column each of :func:`error_columns`; none when empty.
    """

    turn: Floats
    place: Floats
    markers: Floats
    errors: Floats

    def in_base(self, turns: Floats, places: Floats) -> Floats:
        """Return the markers (n, m, 3) in the base frame for poses of the tool."""
        return np.asarray(np.einsum("nij,mj->nmi", turns, self.markers) + places[:, None])

    def predict_markers(self, turns: Floats, places: Floats, columns: Floats | None = None) -> Floats:
        """Return where the device should see the markers (n, m, 3)."""
        points = self.in_base(turns, places)
        if columns is not None and len(self.errors):
            points = points + columns @ self.errors
        return np.asarray(points @ self.turn.T + self.place)


def register(turns: Floats, places: Floats, points: Floats, steps: int = 15) -> Registration:
    """Return the least-squares registration of poses of the tool with markers ``points`` (n, m, 3; NaN = not seen)."""
    found = _initial_registration(turns, places, points)
    for _ in range(steps):
        found, size = _step(found, turns, places, points, None)
        if size < ENDED_MM:
            break
    return found


def fit_arm_errors(
    arm: Arm, q: Floats, points: Floats, start: Registration, steps: int = 4
) -> tuple[Registration, Floats]:
    """Return a registration with small errors of the arm fitted too, and the columns of these errors."""
    turns, places = arm.poses(q)
    columns = error_columns(arm, q, start.in_base(turns, places))
    found = replace(start, errors=np.zeros(columns.shape[-1]))
    for _ in range(steps):
        found, _ = _step(found, turns, places, points, columns)
    return found, columns


def error_columns(arm: Arm, q: Floats, points: Floats) -> Floats:
    """Return how points (n, m, 3) in the base frame move (n, m, 3, errors) with small errors of the arm.

    Six for each axis (a rotation and a shift before it), and two for an error of its angle by sine and cosine. They are
    scaled by what is plausible, so that a fit holds them at size one.
    """
    out = []
    for k, (turn, at) in enumerate(arm.axes(q)):
        away = points - at[:, None]
        for i in range(3):
            out.append(np.cross(turn[:, None, :, i], away) * AXIS_RAD)
            out.append(np.broadcast_to(turn[:, None, :, i] * AXIS_MM, away.shape))
        if not arm.slides[k]:
            sweep = np.cross((turn @ arm.direction[k])[:, None], away) * WAVE_RAD
            angle = q[:, arm.joint[k]]
            out += [sweep * np.sin(angle)[:, None, None], sweep * np.cos(angle)[:, None, None]]
    return np.stack(out, axis=-1)


def marker_jacobian(found: Registration, turns: Floats, places: Floats, errors: Floats | None) -> Floats:
    """Return how the predicted markers (n, m, 3) move (n, m, 3, unknowns) with base, markers and errors."""
    n, m = len(turns), len(found.markers)
    points = found.predict_markers(turns, places, errors) - found.place
    out = np.zeros((n, m, 3, 6 + 3 * m))
    out[..., 0:3] = -_cross_product_matrices(points)
    out[..., 3:6] = np.eye(3)
    lever = found.turn @ turns
    for k in range(m):
        out[:, k, :, 6 + 3 * k : 9 + 3 * k] = lever
    return out if errors is None else np.concatenate([out, found.turn @ errors], axis=-1)


def _cross_product_matrices(points: Floats) -> Floats:
    x, y, z = np.moveaxis(points, -1, 0)
    nil = np.zeros_like(x)
    return np.stack([nil, -z, y, z, nil, -x, -y, x, nil], axis=-1).reshape(*points.shape[:-1], 3, 3)


def _step(
    found: Registration, turns: Floats, places: Floats, points: Floats, errors: Floats | None
) -> tuple[Registration, float]:
    left = points - found.predict_markers(turns, places, errors)
    seen = ~np.isnan(left)
    jacobian = marker_jacobian(found, turns, places, errors)[seen]
    side = jacobian.T @ left[seen]
    square = jacobian.T @ jacobian + 1e-9 * np.eye(jacobian.shape[1])
    if errors is not None:
        first = square.shape[0] - errors.shape[-1]
        held = np.arange(first, square.shape[0])
        square[held, held] += NOISE_MM**2
        side[first:] -= NOISE_MM**2 * found.errors
    step = np.linalg.solve(square, side)
    turn = rotations(np.asarray(step[None, :3], dtype=np.float64))[0]
    m = len(found.markers)
    moved = Registration(
        turn @ found.turn,
        found.place + step[3:6],
        found.markers + step[6 : 6 + 3 * m].reshape(m, 3),
        found.errors + step[6 + 3 * m :] if errors is not None else found.errors,
    )
    return moved, float(np.abs(jacobian @ step).max(initial=0.0))


def _initial_registration(turns: Floats, places: Floats, points: Floats) -> Registration:
    """Lay the tool points over the markers, then set the markers where they are on average; twice."""
    m = points.shape[1]
    markers = np.zeros((m, 3))
    turn, place = np.eye(3), np.zeros(3)
    for _ in range(3):
        own = np.einsum("nij,mj->nmi", turns, markers) + places[:, None]
        seen = ~np.isnan(points[..., 0])
        a, b = own[seen], points[seen]
        middle, there = a.mean(axis=0), b.mean(axis=0)
        u, _, v = np.linalg.svd((b - there).T @ (a - middle))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        place = there - turn @ middle
        local = np.einsum("nji,nmj->nmi", turns, (points - place) @ turn - places[:, None])
        absent = np.isnan(local)
        markers = np.where(absent, 0.0, local).sum(axis=0) / np.maximum((~absent).sum(axis=0), 1)
    return Registration(turn, place, markers, np.zeros(0))


GRID_S = 0.02
FRAME_STEPS = 3  # of the grid, between two frames: then one lag rounds alike for all
MOST_FRAMES = 12_000
MOST_MARKERS = 3
REACH_S = 12.0  # longer jumps leave rows that no lag explains
TRIED = 25
WINDOW_FRAMES = 120
LEAST_FRAMES = 20
CLEARLY = 0.012  # of the spread: no wrong lag leaves so little
WINDOW_S = (20.0, 90.0)
SHORTER = (1, 2, 4)  # shorter stretches are tried where a jump lies in every longer one

GRID_HZ = 50.0
APART_S = 0.3


class Frames(NamedTuple):
    """The recording, thinned again: even times (n), points (n, markers, 3); the log's even grid; poses of the tool on it."""

    t_s: Floats
    points: Floats
    grid_s: Floats
    turns: Floats
    places: Floats

    def grid_indices(self, lag_s: float | Floats, index: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.int64]:
        """Return the grid's numbers of frames at a lag."""
        return np.asarray(np.round((self.t_s[index] + lag_s - self.grid_s[0]) / GRID_S).astype(np.int64))

    def snap_lag_to_grid(self, lag_s: float) -> float:
        """Return the nearest lag at which the frames fall on the grid."""
        away = self.grid_s[0] - self.t_s[0]
        return float(np.round((lag_s - away) / GRID_S) * GRID_S + away)

    def speeds(self) -> Floats:
        """Return the fastest marker's speed at each frame, mm/s; 0 where none is known."""
        step = np.linalg.norm(np.gradient(self.points, self.t_s, axis=0), axis=2)
        return np.asarray(np.max(np.nan_to_num(step), axis=1))


@dataclass(frozen=True)
class Window:
    """Frames that one registration explains at one lag, and what it leaves of the markers' spread."""

    found: Registration
    lag_s: float
    share: float
    index: NDArray[np.int64]


def sample_frames(thinned: Thinned, log: JointLog, arm: Arm | None) -> Frames:
    """Take the best-seen markers at about 20 Hz, and where the arm's tool is on the log's grid."""
    assert log.t_s is not None
    seen = (~np.isnan(thinned.points_mm[..., 0])).sum(axis=0)
    best = np.sort(np.argsort(-seen, kind="stable")[:MOST_MARKERS])
    span = float(thinned.t_s[-1] - thinned.t_s[0])
    t = np.arange(thinned.t_s[0], thinned.t_s[-1], GRID_S * max(FRAME_STEPS, math.ceil(span / MOST_FRAMES / GRID_S)))
    grid = np.arange(log.t_s[0], log.t_s[-1], GRID_S)
    turns, places = np.zeros((0, 3, 3)), np.zeros((0, 3))
    if arm is not None:
        turns, places = arm.poses(np.stack([np.interp(grid, log.t_s, q) for q in arm.reading(log).T], axis=1))
    return Frames(t, _interpolate_markers(thinned, t, best), grid, turns, places)


def _interpolate_markers(thinned: Thinned, t: Floats, markers: NDArray[np.int64]) -> Floats:
    """The markers at times ``t``, in a straight line between frames; NaN where either was not seen."""
    k = np.clip(np.searchsorted(thinned.t_s, t, side="right") - 1, 0, len(thinned.t_s) - 2)
    share = np.clip((t - thinned.t_s[k]) / (thinned.t_s[k + 1] - thinned.t_s[k]), 0.0, 1.0)[:, None, None]
    points = thinned.points_mm[:, markers]
    return np.asarray((1 - share) * points[k] + share * points[k + 1])


def spread(points: Floats) -> float:
    """Return the root mean square distance of points from their mean, mm."""
    flat = points.reshape(-1, 3)
    flat = flat[~np.isnan(flat[:, 0])]
    return float(np.sqrt(np.mean(np.sum((flat - flat.mean(axis=0)) ** 2, axis=1)))) if len(flat) else 0.0


def best_windows(thinned: Thinned, log: JointLog, frames: Frames) -> Iterator[Window]:
    """Return the stretches of the recording that the model explains best, at whatever lag; each of half the length."""
    length = float(np.clip((frames.t_s[-1] - frames.t_s[0]) / 5, *WINDOW_S))
    for part in SHORTER:
        window = _best_window(thinned, log, frames, length / part)
        if window is not None:
            yield window


def _best_window(thinned: Thinned, log: JointLog, frames: Frames, length: float) -> Window | None:
    start, end = float(frames.t_s[0]), float(frames.t_s[-1])
    best, least = None, 0.3 * spread(frames.points)
    for begin in np.arange(start, max(end - length / 2, start + 0.1), length / 2):
        own = (thinned.t_s >= begin) & (thinned.t_s < begin + length)
        index = np.flatnonzero((frames.t_s >= begin) & (frames.t_s < begin + length))
        index = index[:: max(1, -(-len(index) // WINDOW_FRAMES))]
        if len(index) < LEAST_FRAMES or spread(frames.points[index]) < least:
            continue
        part = Thinned(thinned.t_s[own], thinned.points_mm[own], thinned.step_s)
        tried = [_register_window(frames, index, lag, 4) for lag in likeness(part, log).peaks(TRIED)]
        best = min([w for w in (best, *tried) if w is not None], key=lambda w: w.share, default=None)
        if best is not None and best.share < CLEARLY:
            break
    if best is None:
        return None
    near = [_register_window(frames, best.index, best.lag_s + k * GRID_S, 8) for k in range(-10, 11)]
    return min([best, *(w for w in near if w is not None)], key=lambda w: w.share)


def _register_window(frames: Frames, index: NDArray[np.int64], lag: float, steps: int) -> Window | None:
    at = frames.grid_indices(lag, index)
    good = (at >= 0) & (at < len(frames.grid_s)) & ~np.isnan(frames.points[index, :, 0]).all(axis=1)
    if good.sum() < 0.8 * len(index):
        return None
    points, at = frames.points[index][good], at[good]
    found = register(frames.turns[at], frames.places[at], points, steps)
    left = points - found.predict_markers(frames.turns[at], frames.places[at])
    size = np.sum(left[~np.isnan(left[..., 0])] ** 2, axis=-1)
    return Window(found, lag, float(np.sqrt(np.mean(size))) / max(spread(points), 1e-9), index)


def register_again(frames: Frames, lags_s: Floats, before: Registration, limit_mm: float) -> tuple[Registration, float]:
    """Register anew with the frames that ``before`` explains to ``limit_mm`` at their lags; return what it leaves, mm."""
    at = frames.grid_indices(lags_s)
    inside = np.flatnonzero((at >= 0) & (at < len(frames.grid_s)))
    off = _off(frames.points[inside], before.predict_markers(frames.turns[at[inside]], frames.places[at[inside]]))
    with np.errstate(invalid="ignore"):
        good = inside[np.sqrt(off) < limit_mm]
    if len(good) < LEAST_FRAMES:
        return before, limit_mm / 5
    good = good[:: max(1, len(good) // 800)]
    turns, places, points = frames.turns[at[good]], frames.places[at[good]], frames.points[good]
    found = register(turns, places, points)
    return found, float(np.sqrt(np.nanmedian(_off(points, found.predict_markers(turns, places)))))


def _off(points: Floats, predicted: Floats) -> Floats:
    """Mean square distance over the markers that are seen (n)."""
    square = np.sum((points - predicted) ** 2, axis=-1)
    seen = ~np.isnan(square)
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.where(seen, square, 0.0).sum(axis=-1) / np.where(seen.any(axis=-1), seen.sum(axis=-1), np.nan)
        )


def squares_by_model(frames: Frames, found: Registration, lag_s: float) -> Floats:
    """Return mean squares (n, lags) mm² of frames at lags about ``lag_s``; NaN where nothing is known.

    |a - b|² is taken apart, so that each frame costs one product of a matrix and a vector.
    """
    centre = found.place
    there = found.predict_markers(frames.turns, frames.places) - centre
    table = np.hstack([there.reshape(len(there), -1), np.sum(there**2, axis=-1)])
    seen = ~np.isnan(frames.points[..., 0])
    here = np.where(seen[..., None], frames.points - centre, 0.0)
    own = np.hstack([-2.0 * here.reshape(len(here), -1), seen])
    size = np.sum(here**2, axis=(1, 2))
    count = np.where(seen.any(axis=1), seen.sum(axis=1), np.nan)
    return _over_lags(frames, lag_s, table, own, size) / count[:, None].astype(np.float32)


def squares_by_speed(thinned: Thinned, log: JointLog, frames: Frames, lag_s: float) -> Floats:
    """Return squares (n, lags) of the difference of the two speeds, each at size one."""
    assert log.t_s is not None
    ours = even(np.interp(frames.t_s, *marker_speed(thinned)))
    theirs = even(np.interp(frames.grid_s, log.t_s, joint_speed(log)))
    own = np.stack([-2.0 * ours, np.ones_like(ours)], axis=1)
    return _over_lags(frames, lag_s, np.stack([theirs, theirs**2], axis=1), own, ours**2)


def _over_lags(frames: Frames, lag_s: float, table: Floats, own: Floats, size: Floats) -> Floats:
    """``table`` (grid, k) times ``own`` (n, k) plus ``size`` (n) for each frame and the grid's rows about its lag."""
    reach, first = round(REACH_S / GRID_S), frames.grid_indices(lag_s)
    out = np.full((len(first), 2 * reach + 1), np.nan, dtype=np.float32)
    for i, at in enumerate(first):
        low, high = max(0, at - reach), min(len(table), at + reach + 1)
        if high > low:
            out[i, low - at + reach : high - at + reach] = table[low:high] @ own[i] + size[i]
    return np.maximum(out, 0.0, out=out)


@dataclass(frozen=True)
class Likeness:
    """Lags (log time - recording time, s), what each scores, and the correlation of the speeds at the best."""

    lags_s: Floats
    scores: Floats
    correlation: float

    @property
    def best_s(self) -> float:
        """The lag that scores most."""
        return float(self.lags_s[int(np.argmax(self.scores))])

    def peaks(self, most: int) -> list[float]:
        """Return the lags of the highest scores, each at least 0.3 s from the others."""
        out: list[float] = []
        width = round(APART_S * GRID_HZ)
        order = np.argsort(self.lags_s)
        scores, lags = self.scores[order], self.lags_s[order]
        while len(out) < most and np.isfinite(best := scores.max()) and best > 0:
            k = int(np.argmax(scores))
            out.append(float(lags[k]))
            scores[max(0, k - width) : k + width + 1] = -np.inf
        return out


def likeness(thinned: Thinned, log: JointLog) -> Likeness:
    """Correlate the two speeds over all lags at which a quarter of the shorter one overlaps."""
    assert log.t_s is not None
    ours = np.arange(thinned.t_s[0], thinned.t_s[-1], 1 / GRID_HZ)
    theirs = np.arange(log.t_s[0], log.t_s[-1], 1 / GRID_HZ)
    a, b = even(np.interp(ours, *marker_speed(thinned))), even(np.interp(theirs, log.t_s, joint_speed(log)))
    size = len(a) + len(b)
    together = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    lags = np.arange(size)
    lags[lags >= len(b)] -= size
    overlap = np.minimum(len(b), lags + len(a)) - np.maximum(0, lags)
    score = np.where(overlap >= min(len(a), len(b)) / 4, together / np.sqrt(len(a) * len(b)), -np.inf)
    best = int(np.argmax(score))
    first, second = max(0, lags[best]), max(0, -lags[best])
    n = int(overlap[best])
    part = np.corrcoef(a[second : second + n], b[first : first + n])[0, 1] if n > 2 else 0.0
    return Likeness(theirs[0] - ours[0] + lags / GRID_HZ, score, float(np.nan_to_num(part)))


def marker_speed(thinned: Thinned) -> tuple[Floats, Floats]:
    """Return times and the median marker's speed, mm/s."""
    step = np.linalg.norm(np.diff(thinned.points_mm, axis=0), axis=2)
    known = ~np.isnan(step).all(axis=1)
    return (thinned.t_s[1:] + thinned.t_s[:-1])[known] / 2, np.nanmedian(step[known], axis=1) / thinned.step_s


def joint_speed(log: JointLog) -> Floats:
    """Return how fast the joints go together at each row, deg/s."""
    assert log.t_s is not None
    return np.asarray(np.linalg.norm(np.gradient(log.q_even(), log.t_s, axis=0), axis=1))


def even(speed: Floats) -> Floats:
    """Root of the speed, without mean, at size one: slow motions count too."""
    root = np.sqrt(np.clip(speed, 0, np.quantile(speed, 0.98) if len(speed) else 0))
    centred = root - root.mean()
    return np.asarray(centred / max(float(centred.std()), 1e-12))
