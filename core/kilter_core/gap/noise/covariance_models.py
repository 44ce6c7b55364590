"""Covariances from repeats: one for the room or by a tracker's line of sight, and from visits under other loads.

Geometry and every other error of a pose are the same for all its visits, so these differ by noise, by drift, and by what
sides and loads do. The library's candidates of sides and loads are fitted to the differences, and what they leave is noise
as that of repeats is. Too few differences to fit them leave a bound: the noise is this at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.noise.shared_drift import SCALARS_BESIDE_DRIFT, moments_and_motions, scalar_blocks, visit_clocks
from kilter_core.gap.noise.variogram import SPIKE
from kilter_core.gap.noise.visits import Visits, isolate_unused_visits
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

PASSES = 4  # selections without the visits that are spikes for the one before
SEEN = 1e-6  # of a column's length: less of it between visits is rounding


@dataclass(frozen=True)
class PairModel:
    """Candidates of sides and loads by which visits of one pose differ.

    ``pose (V,)`` numbers what revisits share: pose, session and contact. ``W (V, m, Q)`` are derivatives of what was measured
    by the library ``columns (Q,)``; ``candidates`` are places of these that are fitted together,
    and ``whole`` says that they are all that the library has.
    """

    pose: Ints
    W: Floats
    columns: Ints
    candidates: tuple[tuple[int, ...], ...]
    visits: Visits
    points: Floats | None
    lengths: int | None
    whole: bool = True

    def fit_sides_and_loads(self, mean: Floats, used: Bools) -> tuple[Floats, int]:
        """What sides and loads do to the visits (V, m), by the candidates that their differences show; and how many
        numbers were fitted for it.
        """
        kept = used & (np.bincount(self.pose[used], minlength=int(self.pose.max()) + 1)[self.pose] > 1)
        size = mean.shape[1]
        for _ in range(PASSES):
            scale = self._scales(mean, kept)
            y = self._differences(mean[:, :, None], kept, scale)[:, 0]
            X = self._differences(np.concatenate([self.W, self._drift], axis=2), kept, scale)
            chosen = _select_columns(X, y, self._candidates_with_drift, len(y) - size * len(np.unique(self.pose[kept])))
            amounts = np.linalg.lstsq(X[:, chosen], y, rcond=SEEN)[0]
            left = np.abs((y - X[:, chosen] @ amounts).reshape(-1, size)).max(axis=1)
            near = left <= SPIKE * max(float(np.median(left)), SEEN)
            if near.all():
                break
            kept[np.flatnonzero(kept)[~near]] = False
        own = [k for k in chosen if k < len(self.columns)]
        return self.W[:, :, own] @ amounts[[chosen.index(k) for k in own]], len(own)

    def separable(self, used: Bools) -> bool:
        """Whether enough is left of the differences when every candidate of sides and loads is fitted to them."""
        size = self.W.shape[1]
        X = self._differences(self.W, used, np.ones(size))
        norms = np.linalg.norm(X, axis=0)
        rank = np.linalg.matrix_rank(X / np.where(norms > 0.0, norms, 1.0), tol=np.sqrt(SEEN)) if X.size else 0
        free = size * (int(used.sum()) - len(np.unique(self.pose[used])))
        return bool(self.whole and free - rank >= SCALARS_BESIDE_DRIFT)

    def _differences(self, values: Floats, kept: Bools, scale: Floats) -> Floats:
        """Rows (R, K) of values (V, m, K) less the mean of their pose, in units of ``scale (m,)``."""
        made = subtract_group_means(values, isolate_unused_visits(self.pose, kept))[kept] / scale[:, None]
        return np.asarray(made.reshape(-1, values.shape[2]))

    def _scales(self, mean: Floats, kept: Bools) -> Floats:
        """A usual difference (m,) of each number's kind: lengths and rotations are compared in these."""
        away, out = (
            np.abs(subtract_group_means(mean, isolate_unused_visits(self.pose, kept))[kept]),
            np.ones(mean.shape[1]),
        )
        for block in scalar_blocks(mean.shape[1], self.lengths):
            out[block] = max(float(np.median(away[:, block], axis=None)), 1e-12)
        return out

    @cached_property
    def _drift(self) -> Floats:
        """Columns (V, m, K) of a drift that all visits share, so that it is not taken for sides or loads."""
        return moments_and_motions(self.pose, visit_clocks(self.visits)[0], self.points, self.W.shape[1])

    @cached_property
    def _candidates_with_drift(self) -> tuple[tuple[int, ...], ...]:
        """The candidates, and the drift along each clock."""
        start, count = len(self.columns), self._drift.shape[2]
        return (*self.candidates, *((tuple(range(start, start + count)),) if count else ()))


def _select_columns(X: Floats, y: Floats, candidates: Sequence[tuple[int, ...]], free: int) -> list[int]:
    """Columns (R, K) that rows ``y (R,)`` of so much freedom show, the candidate that gains most first.

    A candidate pays for its numbers as by Schwarz, and for having been chosen among so many.
    """
    norms = np.linalg.norm(X, axis=0)
    X = X / np.where(norms > 0.0, norms, 1.0)
    chosen: list[int] = []
    left, r = X.copy(), y.copy()
    paid = 2.0 * np.log(max(len(candidates), 1))
    while True:
        best, gain = None, 0.0
        for columns in candidates:
            u = _basis(left[:, [k for k in columns if k not in chosen]])
            rest, d = free - len(chosen), u.shape[1]
            if not d or rest - d < SCALARS_BESIDE_DRIFT:
                continue
            yy = float(r @ r)
            after = max(yy - float(np.sum((u.T @ r) ** 2)), SEEN**2 * yy)
            value = rest * np.log(yy / after) - d * np.log(rest) - paid if yy > 0.0 else 0.0
            if value > gain:
                best, gain, basis = columns, value, u
        if best is None:
            return chosen
        chosen += [k for k in best if k not in chosen]
        left, r = left - basis @ (basis.T @ left), r - basis @ (basis.T @ r)


def _basis(columns: Floats) -> Floats:
    """Orthonormal basis (R, d) of unit columns (R, K) of which something else was taken out."""
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > np.sqrt(SEEN)])


SPHERICAL = 0.001  # chance of calling equal variances unequal
SMALLEST = (
    1e-7  # m or rad: below any instrument; keeps simulations without noise, and repeats that are copies, solvable
)
FEWEST_OF_SIGHT = 20  # deviations from which a line of sight is looked for


def spread(pooled: tuple[Floats, Ints], vectors: float, rows_at: Floats | None, visits_at: Floats | None) -> Floats:
    """Covariance at each visit (V, m, m): one for the room, or by the line of sight when that fits better."""
    deviation, index = pooled
    room = shrunk(second(deviation), vectors) if vectors else np.eye(deviation.shape[1])
    if visits_at is None or rows_at is None:
        return room[None]
    flat = np.broadcast_to(room, (len(visits_at), *room.shape)).copy()
    if deviation.shape[1] != 3 or vectors < FEWEST_OF_SIGHT:
        return flat
    sight = _Sight.from_deviations(deviation, rows_at[index])
    share = vectors / len(deviation)
    gain = share * (
        _likelihood(deviation, sight.covariances_at_points(rows_at[index]))
        - _likelihood(deviation, np.broadcast_to(room, (len(index), 3, 3)))
    )
    # Schwarz's price of every number more: one where all coordinates are equal, six of a free covariance.
    more = sight.numbers - (1 if np.allclose(room, room[0, 0] * np.eye(3)) else 6)
    return sight.covariances_at_points(visits_at) if gain > 0.5 * more * np.log(vectors) else flat


@dataclass(frozen=True)
class _Sight:
    """Tracker at the origin of the measurements: variance along the line of sight, and a + b d² across it."""

    along: float
    across: float
    angle: float

    @property
    def numbers(self) -> int:
        """How many were found."""
        return 1 + int(self.across > 0.0) + int(self.angle > 0.0)

    @staticmethod
    def from_deviations(deviation: Floats, at: Floats) -> _Sight:
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

    def covariances_at_points(self, points: Floats) -> Floats:
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


def second(deviation: Floats) -> Floats:
    """Mean outer product (m, m) of deviations (P, m)."""
    return np.asarray(deviation.T @ deviation / max(len(deviation), 1))


def shrunk(cov: Floats, vectors: float) -> Floats:
    """Covariance with equal variances within each triple, unless the repeats clearly say otherwise.

    A free 3x3 covariance from ten repeats has axes wrong by half; whitening with it makes names out of the worst axis.
    Bartlett's test of sphericity decides, and even then the estimate is pulled towards equal variances.
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


def approach(total: Floats, known: Floats, vectors: float) -> Floats:
    """Covariance of the approach: what repeated visits scatter in all, less the ``known`` part of their rows.

    Equal in all directions unless the sum clearly says otherwise: a difference of two estimates has directions in which
    nothing is left by chance, and whitening by those makes names.
    """
    model = known + even(np.diag(np.maximum(np.diag(even(total - known)), 0.0)))
    root = np.linalg.cholesky(model + SMALLEST**2 * np.eye(len(model)))
    back = np.linalg.inv(root)
    return _positive(root @ shrunk(back @ total @ back.T, vectors) @ root.T - known)


def even(cov: Floats) -> Floats:
    """Covariances (..., m, m) with one variance for points, and of poses (m 6) another for the rotations."""
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
