"""Covariances from repeats: one for the whole room or by a tracker's line of sight, and no more shape than is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from kilter_core.types import Floats, Ints

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
