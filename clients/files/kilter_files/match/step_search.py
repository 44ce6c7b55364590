"""Steps in signs that should stay the same, and which marker moved between two shapes of a body."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from kilter_files.ground.arrays import Floats

LEAST_MM = 0.12  # what changes by less is heat, or the device's own distortion
SURE = 7.0  # standard deviations of the difference of two means
MOST_STEPS = 4

Cut = tuple[int, int, int, Floats, Floats]

LIGHT = 1e-3
MOST_EXCHANGED = 6  # markers, of which every order is tried


def find_step_cuts(signs: Floats, first: int, after: int, depth: int = 0) -> list[Cut]:
    """Cut rows ``first`` to ``after`` where the means change most, then both parts: (first, cut, after, change, sigma)."""
    part = signs[first:after]
    if len(part) < 4 or depth > MOST_STEPS:
        return []
    change, error, at = _best_cut(part)
    if at is None:
        return []
    sigma = _scatter(np.vstack([part[:at] - _middle(part[:at]), part[at:] - _middle(part[at:])]))
    with np.errstate(invalid="ignore"):
        real = (np.abs(change) > LEAST_MM) & (np.abs(change) > SURE * error * sigma)
    if not real.any() or not _is_step(part[:, real], at):
        return []
    cut = first + at
    return [
        *find_step_cuts(signs, first, cut, depth + 1),
        (first, cut, after, change, np.maximum(error * sigma, 1e-9)),
        *find_step_cuts(signs, cut, after, depth + 1),
    ]


def _best_cut(part: Floats) -> tuple[Floats, Floats, int | None]:
    """The cut whose means differ most, by the noise between neighbours: the differences, and their error per scatter."""
    seen = ~np.isnan(part)
    count = np.cumsum(seen, axis=0)[:-1]
    other = seen.sum(axis=0) - count
    # from the median, so that the sums keep their digits
    away = np.where(seen, part - _middle(part), 0.0)
    total = np.cumsum(away, axis=0)[:-1]
    rest = away.sum(axis=0) - total
    with np.errstate(invalid="ignore", divide="ignore"):
        change = rest / other - total / count
        error = np.sqrt(1.0 / count + 1.0 / other)
        steps = _scatter(np.diff(part, axis=0)) / np.sqrt(2)
        score = np.abs(change) / (error * np.maximum(steps, 1e-4))
    score = np.where((count > 0) & (other > 0) & (np.abs(change) > LEAST_MM), score, 0.0)
    worst = score.max(axis=1)
    if not worst.max(initial=0.0) > SURE:
        return change[0], error[0], None
    at = int(np.argmax(worst))
    return change[at], error[at], at + 1


def _middle(values: Floats) -> Floats:
    known = ~np.isnan(values).all(axis=0)
    out = np.full(values.shape[1], np.nan)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out


def _scatter(values: Floats) -> Floats:
    """Robust standard deviation of columns."""
    return np.asarray(1.4826 * _middle(np.abs(values - _middle(values))))


def _is_step(part: Floats, at: int) -> bool:
    """Whether a step leaves less than a line in time: heat makes lines."""
    t = np.arange(len(part), dtype=np.float64)
    step = line = 0.0
    for column in part.T:
        seen = ~np.isnan(column)
        y, x = column[seen], t[seen]
        step += sum(float(((side - side.mean()) ** 2).sum()) for side in (y[x < at], y[x >= at]) if len(side))
        line += float(((y - np.polyval(np.polyfit(x, y, 1), x)) ** 2).sum())
    return step < line


def moved_alone(before: Floats, after: Floats) -> list[int]:
    """The markers without which the others keep their shape: one, unless the shape leaves it open."""
    left = []
    for k in range(len(before)):
        others = np.delete(np.arange(len(before)), k)
        turned, shift = laid(before[others], after[others], np.ones(len(others)))
        left.append(float(np.linalg.norm(after[others] - (before[others] @ turned.T + shift), axis=1).max()))
    return [k for k, size in enumerate(left) if size <= max(1.5 * min(left), 0.03)] if min(left) < LEAST_MM else []


def marker_displacement(before: Floats, after: Floats, k: int) -> float:
    """How far marker ``k`` is from where it was, seen from the others; with two others, in the plane of the three."""
    light = np.ones(len(before))
    light[k] = LIGHT
    turned, shift = laid(before, after, light)
    return float(np.linalg.norm(after[k] - (turned @ before[k] + shift)))


def laid(shape: Floats, points: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return rotation and shift that lay ``shape`` (m, 3) over ``points`` (m, 3), each marker by its weight."""
    share = weight / weight.sum()
    a, b = share @ shape, share @ points
    u, _, v = np.linalg.svd((points - b).T @ (share[:, None] * (shape - a)))
    turned = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return turned, b - turned @ a


def changed_places(points: Floats, at: int) -> tuple[int, ...]:
    """Markers (from 0) whose exchange from row ``at`` on restores the former body; none where no exchange does."""
    before, after = (_lengths(part) for part in (points[:at], points[at:]))
    if len(before) > MOST_EXCHANGED or np.isnan(before).any() or np.isnan(after).any():
        return ()
    fitting = [
        tuple(k for k, other in enumerate(order) if k != other)
        for order in permutations(range(len(before)))
        if np.abs(after[np.ix_(order, order)] - before).max() < LEAST_MM
    ]
    return min(filter(None, fitting), key=len, default=())  # an even triangle allows more exchanges than were made


def _lengths(points: Floats) -> Floats:
    """Median distances (m, m) between markers (n, m, 3); NaN where two were never seen together."""
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    seen = ~np.isnan(apart).all(axis=0)
    out = np.full(seen.shape, np.nan)
    out[seen] = np.nanmedian(apart[:, seen], axis=0)
    return out
