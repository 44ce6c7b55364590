"""Markers knocked in the middle of a measurement: distances between markers that are others from some moment on.

Distances do not care how the body moves. Where their means before and after a moment differ by far more than they scatter,
a marker moved on the body, and the one without which all distances stay is the one.
"""

from __future__ import annotations

from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.match.dwells import Thinned, mean_seen
from kilter_files.match.rigid_body import align_shape, mean_shape

SHARED = 2.0  # a marker's shift is shared out among all by the fit of the shape
MOST_MARKERS = 12
SINGLE_ROWS = 2000  # more are averaged in stretches
CHUNK_S, MOST_CHUNKS = 0.5, 400


class Knock(NamedTuple):
    """Between two times the markers of these numbers (from 0; one of them, if ``sure`` is not) moved on the body.

    ``flat``: of two or three markers only what changes their distances is seen.
    """

    from_s: float
    to_s: float
    markers: tuple[int, ...]
    size_mm: float
    sure: bool
    flat: bool

    def describe_knock(self, names: tuple[str, ...], unit: str = "s") -> str:
        """Say it in words; ``unit`` "rows" for times that are numbers of rows."""
        which = (" and " if self.sure else " or ").join(repr(names[k]) for k in self.markers)
        many = "s" if self.sure and len(self.markers) > 1 else ""
        least = "at least " if self.flat else ""
        when = f"between {self.from_s:.2f} and {self.to_s:.2f} s"
        if unit == "rows":
            when = f"between rows {self.from_s:.0f} and {self.to_s:.0f}"
        return f"marker{many} {which} moved {least}{self.size_mm:.2f} mm on the body {when}"


def knocks_of_rows(points: Floats, spans: Floats | None = None) -> list[Knock]:
    """Find knocks in rows: markers (n, m, 3) and the time (n, 2) of each, else its number; many are averaged in stretches."""
    if spans is None:
        spans = np.repeat(np.arange(1.0, len(points) + 1)[:, None], 2, axis=1)
    return _knocks(points, spans, 1 if len(points) <= SINGLE_ROWS else len(points) // MOST_CHUNKS)


def knocks_of_frames(thinned: Thinned) -> list[Knock]:
    """Find knocks in a recording in motion: distances are averaged over half a second or more."""
    n = len(thinned.t_s)
    count = max(1, min(MOST_CHUNKS, int(n * thinned.step_s / CHUNK_S)))
    return _knocks(thinned.points_mm, np.stack([thinned.t_s, thinned.t_s], axis=1), max(1, n // count))


def _knocks(points: Floats, spans: Floats, width: int) -> list[Knock]:
    """Find knocks in stretches of ``width`` frames, each averaged; ``spans`` (n, 2) are the times of the frames."""
    n = len(points) // width
    points, spans = (
        points[: n * width],
        np.stack([spans[: n * width : width, 0], spans[width - 1 : n * width : width, 1]], axis=1),
    )
    chosen = np.sort(np.argsort(-(~np.isnan(points[..., 0])).sum(axis=0), kind="stable")[:MOST_MARKERS])
    if len(chosen) < 2 or n < 4:
        return []
    own = points[:, chosen]
    signs = _signs(own)
    cuts = find_step_cuts(mean_seen(signs.reshape(n, width, -1), 1), 0, n)
    middles = own.reshape(n, width, *own.shape[1:])[:, width // 2]
    return _knocks_from_cuts(middles, spans, cuts, chosen)


def _knocks_from_cuts(points: Floats, spans: Floats, cuts: list[Cut], chosen: NDArray[np.int64]) -> list[Knock]:
    """Make knocks of cuts; a row in the middle of which the knock came gives two cuts, which are one."""
    out: list[Knock] = []
    for cut in cuts:
        knock = _knock(points, spans, *cut)
        knock = knock._replace(markers=tuple(int(chosen[i]) for i in knock.markers))
        if out and knock.from_s < out[-1].to_s:
            larger = max(out[-1], knock, key=lambda k: k.size_mm)
            out[-1] = larger._replace(from_s=out[-1].from_s, to_s=knock.to_s)
        else:
            out.append(knock)
    return out


def _distances(points: Floats) -> Floats:
    pairs = list(combinations(range(points.shape[1]), 2))
    a, b = [p[0] for p in pairs], [p[1] for p in pairs]
    return np.asarray(np.linalg.norm(points[:, a] - points[:, b], axis=2))


def _signs(points: Floats) -> Floats:
    """Distances; of four markers and more also how each is off the common shape, along the shape's axes.

    One of four markers in a plane that moves out of it changes no distance, but the shape.
    """
    distances = _distances(points)
    shape = mean_shape(points) if points.shape[1] > 3 else None
    if shape is None:
        return distances
    turned, shift, _ = align_shape(shape, points)
    off = np.einsum("nji,nmj->nmi", turned, points - shift[:, None]) - shape
    off[np.isnan(points[..., 0]).any(axis=1)] = np.nan  # a marker out of sight moves the fit of the others
    return np.hstack([distances, SHARED * off.reshape(len(points), -1)])


def _knock(points: Floats, spans: Floats, first: int, cut: int, after: int, change: Floats, error: Floats) -> Knock:
    m = points.shape[1]
    pairs = list(combinations(range(m), 2))
    limit = np.maximum(LEAST_MM, SURE * error)
    with np.errstate(invalid="ignore"):
        moved = np.abs(change) > limit
    before, later = _shapes(points, first, cut, after)
    if m > 3 and before is not None and later is not None:
        best = moved_alone(before, later)
    else:
        best = [k for k in range(m) if not any(moved[i] for i, pair in enumerate(pairs) if k not in pair)]
    named = best or sorted({k for i, pair in enumerate(pairs) if moved[i] for k in pair}) or list(range(m))
    sizes = [marker_displacement(before, later, k) for k in named] if before is not None and later is not None else []
    size = min([s for s in sizes if np.isfinite(s)], default=float(np.nanmax(np.abs(change))))
    sure = len(named) == 1 or not best
    return Knock(float(spans[cut - 1, 0]), float(spans[cut, 1]), tuple(named), size, sure, m < 4)


def _shapes(points: Floats, first: int, cut: int, after: int) -> tuple[Floats | None, Floats | None]:
    # the rows next to the cut may have the knock in their middle
    last = cut - 1 if cut - first > 2 else cut
    later = cut + 1 if after - cut > 2 else cut
    return mean_shape(points[first:last]), mean_shape(points[later:after])


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
