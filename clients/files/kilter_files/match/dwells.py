"""Dwells: the stretches of a recording in which the robot rests, found from the markers alone.

The recording is read twice, block by block: thinned to find the dwells, then whole to average each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.tables.recording import Recording
from kilter_files.tables.survey import noise

THINNED_HZ = 100.0
BATCHES = 10
KEPT_FRAMES = 20_000
OUTLIER = 8.0
SEEN_SHARE = 0.5


@dataclass(frozen=True)
class RestOptions:
    """When the robot is taken to rest; ``speed_mm_s`` None: five times what the noise of the markers looks like."""

    speed_mm_s: float | None = None
    shortest_s: float = 0.3
    settle_s: float = 0.1


@dataclass(frozen=True)
class Dwell:
    """A rest: mean of each marker (markers, 3; NaN where it was hardly seen), scatter of a frame, and of the mean."""

    start_s: float
    end_s: float
    frames: int
    mean_mm: Floats
    scatter_mm: Floats
    mean_sigma_mm: Floats
    outliers: int


@dataclass(frozen=True)
class Thinned:
    """A recording averaged to about 100 Hz: ``t_s`` (n), ``points_mm`` (n, markers, 3)."""

    t_s: Floats
    points_mm: Floats
    step_s: float


def thin(recording: Recording, rate_hz: float = THINNED_HZ) -> Thinned:
    """Average consecutive frames so that about ``rate_hz`` remain."""
    factor = max(1, int(recording.rate_hz // rate_hz))
    times, points = [], []
    rest_t, rest_p = np.zeros(0), np.zeros((0, len(recording.markers), 3))
    for block in recording.blocks():
        t, p = np.concatenate([rest_t, block.t_s]), np.concatenate([rest_p, block.points_mm])
        whole = len(t) // factor * factor
        times.append(t[:whole].reshape(-1, factor).mean(axis=1))
        points.append(mean_seen(p[:whole].reshape(-1, factor, *p.shape[1:]), 1))
        rest_t, rest_p = t[whole:], p[whole:]
    return Thinned(np.concatenate(times), np.concatenate(points), factor / recording.rate_hz)


def mean_seen(points: Floats, axis: int) -> Floats:
    """Return the mean over ``axis`` of what is not NaN, NaN where nothing is."""
    absent = np.isnan(points)
    count = (~absent).sum(axis=axis)
    total = np.where(absent, 0.0, points).sum(axis=axis)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def find_dwells(recording: Recording, options: RestOptions) -> list[Dwell]:
    """Return the dwells of a recording, in order."""
    thinned = thin(recording)
    return _average_spans(recording, rests(thinned, options))


def rests(thinned: Thinned, options: RestOptions) -> list[tuple[float, float]]:
    """Return start and end of each rest, without the time the arm needs to settle."""
    half = max(1, round(0.05 / thinned.step_s))
    moving = _moving(thinned, half, options.speed_mm_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moving, [True]]).astype(np.int8)))
    spans = _merge_adjacent_rests(thinned, [(int(a), int(b)) for a, b in edges.reshape(-1, 2)])
    found = []
    for first, after in spans:
        start = thinned.t_s[first] + (options.settle_s if first else 0.0)
        end = thinned.t_s[after - 1] - (thinned.step_s * half if after < len(moving) else 0.0)
        if end - start >= options.shortest_s:
            found.append((float(start), float(end)))
    return found


def _moving(thinned: Thinned, half: int, speed: float | None) -> NDArray[np.bool_]:
    """Where the median marker that ever moves goes faster than the limit, or none is seen."""
    p = thinned.points_mm
    if len(p) < 4 * half + 2:
        return np.ones(len(p), bool)
    sigma = noise(p)
    # spans without the outermost fiftieths: a spike is not a motion
    ordered = np.sort(np.where(np.isnan(p), mean_seen(p, 0), p), axis=0)
    span = (ordered[-1 - len(p) // 50] - ordered[len(p) // 50]).max(axis=1)
    with np.errstate(invalid="ignore"):
        mobile = span > np.maximum(2.0, 30 * np.nan_to_num(sigma))
    if not mobile.any():
        mobile[:] = True
    smooth = _windows(p[:, mobile], half)
    shift = np.linalg.norm(smooth[2 * half :] - smooth[: -2 * half], axis=2)
    going = np.full(len(p), np.inf)
    going[half : half + len(shift)] = _median(shift) / (2 * half * thinned.step_s)
    going[:half], going[half + len(shift) :] = going[half], going[half + len(shift) - 1]
    usual = np.nanmedian(sigma[mobile]) if not np.isnan(sigma[mobile]).all() else 0.0
    seeming = usual * np.sqrt(2.0 * 3 / (2 * half + 1)) / (2 * half * thinned.step_s)
    limit = max(1.0, 5.0 * seeming) if speed is None else speed
    return ~(going < limit)


def _windows(p: Floats, half: int) -> Floats:
    """Means over windows of 2 half + 1 frames of what was seen."""
    known = ~np.isnan(p)
    pad = [(half + 1, half), (0, 0), (0, 0)]
    total = np.cumsum(np.pad(np.where(known, p, 0.0), pad), axis=0)
    count = np.cumsum(np.pad(known.astype(np.int64), pad), axis=0)
    width = 2 * half + 1
    n = count[width:] - count[:-width]
    return np.asarray(np.where(n > 0, (total[width:] - total[:-width]) / np.maximum(n, 1), np.nan))


def _median(values: Floats) -> Floats:
    """Median over markers of what is not NaN; infinite where nothing is."""
    ordered = np.sort(values, axis=1)  # NaN comes last
    count = (~np.isnan(values)).sum(axis=1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    return np.asarray(np.where(count > 0, middle, np.inf))


def _merge_adjacent_rests(thinned: Thinned, spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Join rests between which the markers did not go anywhere: a flicker, or a short time out of sight."""
    out: list[tuple[int, int]] = []
    for first, after in spans:
        if (
            out
            and (first - out[-1][1]) * thinned.step_s < 0.5
            and _same_place(thinned.points_mm, out[-1], first, after)
        ):
            out[-1] = (out[-1][0], after)
        else:
            out.append((first, after))
    return out


def _same_place(p: Floats, before: tuple[int, int], first: int, after: int) -> bool:
    old, new = mean_seen(p[before[0] : before[1]], 0), mean_seen(p[first:after], 0)
    between = np.linalg.norm(p[before[1] : first] - old, axis=2)
    apart = np.linalg.norm(new - old, axis=1)
    if np.isnan(apart).all():
        return False
    far = float(np.nanmax(_median(between), initial=0.0, where=np.isfinite(_median(between))))
    return bool(np.nanmedian(apart) < 0.3 and far < 1.0)


def _average_spans(recording: Recording, spans: list[tuple[float, float]]) -> list[Dwell]:
    """Read the frames of each span and average them."""
    out: list[Dwell] = []
    parts: list[Floats] = []
    times: list[Floats] = []
    k = 0
    for block in recording.blocks():
        while k < len(spans):
            start, end = spans[k]
            first, after = np.searchsorted(block.t_s, start), np.searchsorted(block.t_s, end, side="right")
            if after > first:
                parts.append(block.points_mm[first:after])
                times.append(block.t_s[first:after])
            if after >= len(block):
                break
            out += _dwell(parts, times)
            parts, times, k = [], [], k + 1
    return out + _dwell(parts, times)


def _dwell(parts: list[Floats], times: list[Floats]) -> list[Dwell]:
    if not parts:
        return []
    points, t = np.concatenate(parts), np.concatenate(times)
    points = points[:: -(-len(points) // KEPT_FRAMES)].copy()
    seen_share = (~np.isnan(points[..., 0])).mean(axis=0)
    points[:, seen_share < SEEN_SHARE] = np.nan
    outliers = _drop_outliers(points)
    mean = mean_seen(points, 0)
    scatter = np.sqrt(mean_seen((points - mean) ** 2, 0))
    return [
        Dwell(float(t[0]), float(t[-1]), len(t), mean, _rms_over_markers(scatter), _of_mean(points, scatter), outliers)
    ]


def _drop_outliers(points: Floats) -> int:
    known = ~np.isnan(points[..., 0]).all(axis=0)
    middle, size = np.full(points.shape[1:], np.nan), np.full(points.shape[1:], np.nan)
    middle[known] = np.nanmedian(points[:, known], axis=0)
    size[known] = 1.4826 * np.nanmedian(np.abs(points[:, known] - middle[known]), axis=0)
    with np.errstate(invalid="ignore"):
        wild = (np.abs(points - middle) > np.maximum(OUTLIER * size, 1e-3)).any(axis=2)
    points[wild] = np.nan
    return int(wild.sum())


def _of_mean(points: Floats, scatter: Floats) -> Floats:
    """Standard deviation of the mean (3): from means of batches, which see slow wander; never below white noise."""
    count = min(BATCHES, len(points) // 2)
    white = _rms_over_markers(scatter) / np.sqrt(max(1, len(points)))
    if count < 3:
        return _rms_over_markers(scatter)
    batches = np.stack([mean_seen(part, 0) for part in np.array_split(points, count)])
    spread = np.sqrt(mean_seen((batches - mean_seen(batches, 0)) ** 2, 0) * count / (count - 1))
    return np.asarray(np.maximum(_rms_over_markers(spread) / np.sqrt(count), white))


def _rms_over_markers(values: Floats) -> Floats:
    """Root mean square over the markers (markers, 3) -> (3)."""
    return np.asarray(np.sqrt(mean_seen(values * values, 0)))
