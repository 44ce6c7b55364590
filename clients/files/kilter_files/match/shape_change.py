"""Two shapes of one body: which marker moved between them, and by how much."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.match.step_search import LEAST_MM

LIGHT = 1e-3
MOST_EXCHANGED = 6  # markers, of which every order is tried


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
