"""Measurement noise from repeats (E0): within a visit and from one approach to the next, with full covariance.

The only noise that owes nothing to the model. Assuming it 1.5 times too small gives 50 % false alarms, so it is never
guessed: without repeats the hunt goes on with the scatter of the fit itself, and every verdict becomes relative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from core.gap.drift import Drift, Repeats, blocks_of, repeats_of
from core.gap.visits import Visits

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

FEWEST = 3  # independent deviations below which repeats say too little
SPIKE = 6.0  # robust standard deviations from its own repeats at which a row is a spike
SPIKE_PASSES = 4
SPHERICAL = 0.001  # chance of calling equal variances unequal
LENGTHS = 3  # leading scalars of a full pose that are lengths; the others are angles
FIT = "residuals of the fit"
WITHIN = "repeats within visits"
SMALLEST = (
    1e-7  # m or rad: below any instrument; keeps simulations without noise, and repeats that are copies, solvable
)


@dataclass(frozen=True)
class Noise:
    """Covariance (V, m, m) of each visit's mean, and of a single row on average, ``row (m, m)``.

    ``freedom`` is the number of independent scalars behind it; ``absolute`` says it does not come from the fit.
    ``within`` and ``between`` are standard deviations of a coordinate (m, or rad for joint data), None when unknown;
    of poses ``lengths`` says how many of the m scalars are lengths, None for all of them. ``drift`` is what repeats told
    of drift; ``most`` says that they cannot tell it from noise, so that noise is this at most.
    """

    visit: Floats
    row: Floats
    freedom: float
    absolute: bool
    source: str
    within: float | None = None
    between: float | None = None
    lengths: int | None = None
    drift: Drift | None = None
    most: bool = False

    @property
    def coordinate(self) -> float:
        """Standard deviation of one coordinate (m, or rad for joint data) of a single row."""
        return _deviation(self.row, self.lengths)

    def even(self) -> Noise:
        """Equal variances for the coordinates of all points, and for those of turns: what an identification weighs by.

        Where the noise is the model's own error, weights by its covariance would fit another geometry than identify does
        (UR10 series B: 0.47 mm left instead of 0.43), and a name would then be confirmed for filling the difference.
        """
        return replace(self, visit=_even(self.visit), row=_even(self.row))

    def whiteners(self) -> Floats:
        """Inverse Cholesky factors (V, m, m)."""
        size = self.visit.shape[-1]
        L = np.linalg.cholesky(self.visit + SMALLEST**2 * np.eye(size))
        return np.linalg.solve(L, np.broadcast_to(np.eye(size), L.shape))


def spikes(residual: Floats, visits: Visits) -> Bools:
    """Rows (N,) that stand far from the mean of the other rows of their visit: three or more rows tell which.

    The worst row of a visit only, then again without it: a spike pulls the mean that its neighbours are held against.
    """
    out = np.zeros(len(residual), dtype=bool)
    r = np.nan_to_num(residual)
    for _ in range(SPIKE_PASSES):
        kept = ~out
        count = np.bincount(visits.visit[kept], minlength=len(visits))
        told = kept & (count[visits.visit] >= 3)
        if not told.any():
            break
        sums = np.stack([np.bincount(visits.visit[kept], c[kept], len(visits)) for c in r.T], axis=1)
        n = count[visits.visit][:, None].astype(np.float64)
        others = (sums[visits.visit] - r) / np.maximum(n - 1.0, 1.0)
        apart = (r - others) * np.sqrt(np.maximum(n - 1.0, 1.0) / n)
        scale = np.median(np.abs(apart[told]), axis=0) / 0.6745 + SMALLEST
        size = np.where(told, np.abs(apart / scale).max(axis=1), 0.0)
        worst = np.full(len(visits), 0.0)
        np.maximum.at(worst, visits.visit, size)
        found = told & (size > SPIKE) & (size >= worst[visits.visit])
        if not found.any():
            break
        out |= found
    return out


def repeat_noise(residual: Floats, visit_residual: Floats, visits: Visits, points: Floats | None) -> Noise | None:
    """Noise from repeats, None when there are too few.

    ``residual (N, m)`` of the rows and ``visit_residual (V, m)`` of the visit means at a fit: between repeats only
    their differences count, so the model cancels; what drifted between them is told from noise by how far they are apart.
    ``points (V, 3)`` are the measured positions, from which a tracker's line of sight is tried against one covariance
    for the whole room.
    """
    if np.isnan(residual).any():
        residual, visit_residual = np.nan_to_num(residual), np.nan_to_num(visit_residual)
    within, k_within = _pooled(residual, visits.visit)
    share, lengths = 1.0 / visits.count, _lengths(residual.shape[1], visits)
    repeats = repeats_of(visit_residual, visits, points, lengths)
    k_between = repeats.vectors if repeats else 0.0
    if k_within + k_between < FEWEST:
        return None
    at = None if points is None else points
    rows_cov = _spread(within, k_within, None if at is None else at[visits.visit], at)
    if repeats is None or k_between < FEWEST:
        # Rows of one visit say nothing of the next approach: their shape is used, their scale cannot be relied on.
        made = _noise(rows_cov * share[:, None, None], rows_cov.mean(axis=0), k_within, lengths, rows_cov, None)
        return replace(made, absolute=False, source=WITHIN)
    total = _between(repeats, lengths)
    if k_within < FEWEST:
        seen = _spread(total, k_between, at, at)
        visit = np.broadcast_to(seen, (len(visits), *seen.shape[1:])).copy()
        made = _noise(visit, seen.mean(axis=0), k_between, lengths, None, seen)
        return replace(made, drift=repeats.drift, most=repeats.most)
    known = np.mean(rows_cov * share[:, None, None], axis=0)
    extra = _positive(_shrunk(_second(total[0]) - known, k_between))
    visit = extra + rows_cov * share[:, None, None]
    # The scale of the sum is that of the repeated approaches, however well the rows within a visit are known.
    made = _noise(visit, extra + rows_cov.mean(axis=0), k_between, lengths, rows_cov, extra)
    return replace(made, drift=repeats.drift, most=repeats.most)


def _between(repeats: Repeats, lengths: int | None) -> tuple[Floats, Ints]:
    """Deviations of repeats whose mean squares are the variances found, with their visits; equal ones where none are left."""
    deviation, index, size = repeats.deviation, repeats.index, repeats.deviation.shape[1]
    if len(deviation) < FEWEST:
        deviation, index = np.eye(size) * np.sqrt(size), np.zeros(size, dtype=np.int64)
    scaled = np.zeros_like(deviation)
    for block, variance in zip(blocks_of(size, lengths), repeats.variance, strict=True):
        scaled[:, block] = deviation[:, block] * np.sqrt(
            variance / max(float(np.mean(deviation[:, block] ** 2)), 1e-300)
        )
    return scaled, index


def stated_noise(sigma: Floats | float, visits: Visits, size: int) -> Noise:
    """Noise as the user or the columns ``sx_mm ...`` state it: ``sigma`` m, one number or (V, 3) for visit means."""
    if isinstance(sigma, float):
        each = sigma**2 / visits.count[:, None, None] * np.eye(size)
        return Noise(each, sigma**2 * np.eye(size), np.inf, True, "stated", sigma)
    each = np.zeros((len(visits), size, size))
    each[:, range(size), range(size)] = np.tile(sigma**2, (1, size // 3))
    single = float(np.sqrt(np.mean(sigma**2 * visits.count[:, None])))
    return Noise(each, np.mean(each * visits.count[:, None, None], axis=0), np.inf, True, "columns", single)


def fit_noise(visit_residual: Floats, visits: Visits, used: Bools, lost: float) -> Noise:
    """Scatter of the fit itself: no repeats, so the scale is relative. ``lost`` is the share of freedom it took."""
    return _scatter(visit_residual, used, lost, _lengths(visit_residual.shape[1], visits))


def refitted(noise: Noise, visit_residual: Floats, used: Bools, lost: float) -> Noise:
    """The same at another fit of the same visits."""
    return _scatter(visit_residual, used, lost, noise.lengths)


def _scatter(visit_residual: Floats, used: Bools, lost: float, lengths: int | None) -> Noise:
    kept = np.nan_to_num(visit_residual[used])
    size = np.abs(kept - np.median(kept, axis=0))
    robust = np.median(size, axis=0) / 0.6745 + SMALLEST
    inside = kept[(size / robust).max(axis=1) < SPIKE]
    cov = _shrunk(inside.T @ inside / max(len(inside) * (1.0 - lost), 1.0), len(inside))
    each = np.broadcast_to(cov, (len(visit_residual), *cov.shape)).copy()
    return Noise(each, cov, 0.0, False, FIT, lengths=lengths)


def _noise(
    visit: Floats, row: Floats, vectors: float, lengths: int | None, within: Floats | None, between: Floats | None
) -> Noise:
    def size(cov: Floats | None) -> float | None:
        return None if cov is None else _deviation(cov.mean(axis=0) if cov.ndim == 3 else cov, lengths)

    return Noise(visit, row, vectors * visit.shape[-1], True, "repeats", size(within), size(between), lengths)


def _lengths(size: int, visits: Visits) -> int | None:
    """How many of a visit's scalars are lengths where the others are angles: a pose was measured. None otherwise."""
    o = visits.observations
    return LENGTHS if o.rotation is not None and o.position is not None and size == 2 * LENGTHS else None


def _deviation(cov: Floats, lengths: int | None) -> float:
    return float(np.sqrt(np.mean(np.diag(cov)[:lengths])))


def _pooled(values: Floats, group: Ints) -> tuple[tuple[Floats, Ints], int]:
    """Deviations from the mean of their group, made unbiased, without spikes; and how many are independent."""
    count = np.bincount(group)
    many = count[group] > 1
    if not many.any():
        return (np.zeros((0, values.shape[1])), np.zeros(0, dtype=np.int64)), 0
    kept = many.copy()
    deviation = np.zeros_like(values)
    for _ in range(3):
        count = np.bincount(group[kept], minlength=len(count))
        mean = (
            np.stack([np.bincount(group[kept], c[kept], len(count)) for c in values.T], axis=1)
            / np.maximum(count, 1)[:, None]
        )
        free = np.sqrt(np.maximum(count, 2) / np.maximum(count - 1, 1))[group]
        deviation = (values - mean[group]) * free[:, None]
        scale = np.median(np.abs(deviation[kept]), axis=0) / 0.6745 + SMALLEST
        again = many & ((np.abs(deviation) / scale).max(axis=1) < SPIKE) & (count[group] > 1)
        if np.array_equal(again, kept) or not again.any():
            break
        kept = again
    index = np.flatnonzero(kept & (np.bincount(group[kept], minlength=len(count))[group] > 1))
    independent = int(len(index) - len(np.unique(group[index])))
    return (deviation[index], index.astype(np.int64)), independent


def _spread(pooled: tuple[Floats, Ints], vectors: float, rows_at: Floats | None, visits_at: Floats | None) -> Floats:
    """Covariance at each visit (V, m, m): one for the room, or by the line of sight when that fits better."""
    deviation, index = pooled
    room = _shrunk(_second(deviation), vectors) if vectors else np.eye(deviation.shape[1])
    if visits_at is None or rows_at is None:
        return room[None]
    flat = np.broadcast_to(room, (len(visits_at), *room.shape)).copy()
    if deviation.shape[1] != 3 or vectors < 20:
        return flat
    sight = _Sight.of(deviation, rows_at[index])
    share = vectors / len(deviation)
    gain = share * (
        _likelihood(deviation, sight.at(rows_at[index]))
        - _likelihood(deviation, np.broadcast_to(room, (len(index), 3, 3)))
    )
    return sight.at(visits_at) if gain > -1.5 * np.log(vectors) else flat  # three numbers against six


@dataclass(frozen=True)
class _Sight:
    """Tracker at the origin of the measurements: variance along the line of sight, and a + b d² across it."""

    along: float
    across: float
    angle: float

    @staticmethod
    def of(deviation: Floats, at: Floats) -> _Sight:
        d2 = np.sum(at**2, axis=1)
        u = at / np.sqrt(d2)[:, None]
        radial = np.sum(deviation * u, axis=1) ** 2
        side = (np.sum(deviation**2, axis=1) - radial) / 2.0
        start = float(side.mean() / d2.mean())
        # The share that grows with distance, by weighted least squares kept to what variances can be.
        w = 1.0 / np.maximum(start * d2, 1e-300)
        A = np.stack([np.ones_like(d2), d2], axis=1)
        a, b = np.linalg.lstsq(A * w[:, None], side * w, rcond=None)[0]
        if b < 0.0 or np.ptp(d2) < 0.2 * d2.mean():
            return _Sight(float(radial.mean()), float(side.mean()), 0.0)
        return _Sight(float(radial.mean()), 0.0, start) if a < 0.0 else _Sight(float(radial.mean()), float(a), float(b))

    def at(self, points: Floats) -> Floats:
        d2 = np.sum(points**2, axis=1)
        u = points / np.sqrt(d2)[:, None]
        along = u[:, :, None] * u[:, None, :]
        across = self.across + self.angle * d2
        return np.asarray(self.along * along + across[:, None, None] * (np.eye(3) - along))


def _likelihood(deviation: Floats, cov: Floats) -> float:
    safe = cov + SMALLEST**2 * np.eye(3)
    return float(
        -0.5 * np.sum(np.linalg.slogdet(safe)[1] + np.einsum("ni,nij,nj->n", deviation, np.linalg.inv(safe), deviation))
    )


def _second(deviation: Floats) -> Floats:
    return np.asarray(deviation.T @ deviation / max(len(deviation), 1))


def _shrunk(cov: Floats, vectors: float) -> Floats:
    """Covariance with equal variances within each triple, unless the repeats clearly say otherwise.

    A free 3x3 covariance from ten repeats has axes wrong by half; whitening with it makes names out of the worst axis.
    Bartlett's test of sphericity decides, and even then the estimate is drawn towards equal variances.
    """
    size = len(cov)
    target = np.zeros_like(cov)
    step = 3 if size % 3 == 0 else 1
    for k in range(0, size, step):
        target[range(k, k + step), range(k, k + step)] = np.trace(cov[k : k + step, k : k + step]) / step
    sign, logdet = np.linalg.slogdet(cov)
    if sign <= 0 or vectors <= size + 1 or np.any(np.diag(target) <= 0.0):
        return target
    apart = (vectors - (2 * size + 1 + 2 / size) / 6) * float(np.sum(np.log(np.diag(target))) - logdet)
    if chi2.sf(apart, size * (size + 1) / 2 - size / step) > SPHERICAL:
        return target
    pull = (size + 2.0) / (size + 2.0 + vectors)
    return np.asarray((1.0 - pull) * cov + pull * target)


def _even(cov: Floats) -> Floats:
    """Covariances (..., m, m) with one variance for points, and of poses (m 6) another for the turns."""
    size = cov.shape[-1]
    step = 3 if size == 6 else size
    out = np.zeros_like(cov)
    for k in range(0, size, step):
        each = slice(k, k + step)
        out[..., each, each] = (np.trace(cov[..., each, each], axis1=-2, axis2=-1) / step)[..., None, None] * np.eye(
            step
        )
    return out


def _positive(cov: Floats) -> Floats:
    w, V = np.linalg.eigh(cov)
    return np.asarray((V * np.maximum(w, 0.0)) @ V.T)
