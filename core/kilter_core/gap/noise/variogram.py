"""What repeats say at no distance in time and temperature: a variogram with terms that can only grow.

Half the squared difference of two visits of one condition is the noise where nothing drifts. Where something does it grows
with the time and the temperature between them; pooled over all pairs, drift of a day was called noise (1.4 to 5 times too
large) and hid wrong names. The noise is what is left at no distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2

from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

MANY = 8  # visits of a condition from which pairs are taken at lags of powers of two
SPIKE = 6.0  # standard deviations at which a difference is not noise
QUICK = 0.1  # share of the campaign in which a drift that settles does so
KELVIN = 0.1  # range of temperature below which it was constant
DRIFTED = 0.005  # chance, in each of two tests, that stable repeats are said to drift
DRAWS = 499
LARGE = 3000  # pairs from which fewer draws are made
DRAWS_OF_LARGE = 149
PASSES = 12
SEED = 0


@dataclass(frozen=True)
class Pairs:
    """Pairs of visits that should agree: their places (P,), and how far they are apart in time and temperature."""

    first: Ints
    second: Ints
    dt: Floats
    dT: Floats

    def __len__(self) -> int:
        return len(self.first)

    @property
    def terms(self) -> Floats:
        """Growing terms (P, K), 1 at the largest distance: a random walk, a steady drift, one that settles, both of T."""
        out = []
        span = float(self.dt.max(initial=0.0))
        if span > 0.0:
            u = self.dt / span
            out += [u, u**2, 1.0 - np.exp(-u / QUICK)]
        kelvin = float(self.dT.max(initial=0.0))
        if kelvin > KELVIN:
            v = self.dT / kelvin
            out += [v, v**2]
        return np.stack(out, axis=1) if out else np.zeros((len(self), 0))

    @property
    def of_time(self) -> Bools:
        """Which of the terms (K,) grow with time."""
        count = self.terms.shape[1]
        timed = 3 if float(self.dt.max(initial=0.0)) > 0.0 else 0
        return np.arange(count) < timed


@dataclass(frozen=True)
class Variogram:
    """Variance of a coordinate at no distance (``nugget``), growing parts (K,) and the scalars that the nugget rests on.

    ``kept (P,)`` are the pairs used, ``model (P,)`` the variance expected of each.
    """

    nugget: float
    parts: Floats
    freedom: float
    kept: Bools
    model: Floats


def pair_visits(condition: Ints, t: Floats, kelvin: Floats | None) -> Pairs:
    """Pairs of the visits of each condition; of many visits those one, two, four ... places apart in time."""
    order = np.lexsort((t, condition))
    start = np.flatnonzero(np.diff(condition[order], prepend=-1))
    first: list[Ints] = []
    second: list[Ints] = []
    for visits in np.split(order, start[1:]):
        n = len(visits)
        lags = range(1, n) if n <= MANY else [2**k for k in range(n.bit_length()) if 2**k < n]
        for lag in lags:
            first.append(visits[:-lag])
            second.append(visits[lag:])
    i = np.concatenate([*first, np.zeros(0, dtype=np.int64)]).astype(np.int64)
    j = np.concatenate([*second, np.zeros(0, dtype=np.int64)]).astype(np.int64)
    dT = np.zeros(len(i)) if kelvin is None else np.nan_to_num(np.abs(kelvin[i] - kelvin[j]))
    return Pairs(i, j, np.abs(t[i] - t[j]), dT)


def fit_variogram(residual: Floats, pairs: Pairs, drifting: bool) -> Variogram:
    """Variogram of residuals (V, m), one variance for all coordinates; without growing terms unless ``drifting``.

    Weighted by what each pair can say, without the pairs that are spikes for the variance expected of them.
    """
    d = residual[pairs.first] - residual[pairs.second]
    y, worst, size = 0.5 * np.mean(d**2, axis=1), 0.5 * np.max(d**2, axis=1), residual.shape[1]
    X = np.hstack([np.ones((len(y), 1)), pairs.terms[:, : None if drifting else 0]])
    typical = max(float(np.median(y)) * size / float(chi2.median(size)), 1e-300)
    model, kept, part = np.full(len(y), typical), worst < SPIKE**2 * typical, np.zeros(X.shape[1])
    if not kept.any():
        kept[:] = True
    for _ in range(PASSES):
        part = nnls(X[kept] / model[kept, None], y[kept] / model[kept])[0]
        model = np.maximum(X @ part, 1e-3 * typical)
        again = worst < SPIKE**2 * np.maximum(model, typical if not drifting else 0.0)
        if np.array_equal(again, kept) or not again.any():
            break
        kept = again
    used = np.flatnonzero(part > 0.0) if part[0] > 0.0 else np.r_[0, np.flatnonzero(part > 0.0)]
    return Variogram(float(part[0]), part[1:], _freedom(X[:, used], model, kept, pairs, size), kept, model)


def separable(pairs: Pairs, size: int) -> float:
    """Scalars that the noise would rest on if any one growing term had to be distinguished from it; 0 where none could be."""
    every, flat = np.ones(len(pairs), dtype=bool), np.ones(len(pairs))
    terms = pairs.terms
    least = np.inf
    for k in range(terms.shape[1]):
        X = np.stack([np.ones(len(pairs)), terms[:, k]], axis=1)
        least = min(least, _freedom(X, flat, every, pairs, size))
    return float(least)


def chance_of_drift(residual: Floats, condition: Ints, pairs: Pairs) -> float:
    """Chance that stable repeats would seem to grow with time or temperature as much as these.

    Under stable repeats visits of one condition may be exchanged, and conditions of equally many visits.
    """
    terms = pairs.terms
    moving = np.ptp(terms, axis=0) > 1e-9 if len(pairs) else np.zeros(terms.shape[1], dtype=bool)
    if not moving.any():
        return 1.0
    x = terms[:, moving] - terms[:, moving].mean(axis=0)
    x /= np.linalg.norm(x, axis=0)
    away = subtract_group_means(residual, condition)
    rng, swap = np.random.default_rng(SEED), _Exchange.from_conditions(condition)
    cap = SPIKE * float(np.sqrt(np.median(_half_square(away, pairs)) + 1e-300))

    def growth(r: Floats) -> float:
        size = np.minimum(np.sqrt(_half_square(r, pairs)), cap)
        size = size - size.mean()
        length = float(np.linalg.norm(size))
        return float(np.max(size @ x)) / length if length > 0.0 else 0.0

    seen = growth(away)
    draws = DRAWS if len(pairs) < LARGE else DRAWS_OF_LARGE
    more = sum(growth(away[swap.draw(rng)]) >= seen for _ in range(draws))
    return (1.0 + more) / (draws + 1.0)


@dataclass(frozen=True)
class _Exchange:
    """Visits sorted by condition, and conditions of each size, to be exchanged at random."""

    groups: tuple[Ints, ...]  # (conditions, visits of each) of equal size

    @staticmethod
    def from_conditions(condition: Ints) -> _Exchange:
        order = np.argsort(condition, kind="stable")
        start = np.flatnonzero(np.diff(condition[order], prepend=-1))
        parts = np.split(order, start[1:])
        sizes = sorted({len(p) for p in parts})
        return _Exchange(tuple(np.stack([p for p in parts if len(p) == n]).astype(np.int64) for n in sizes))

    def draw(self, rng: np.random.Generator) -> Ints:
        """Which visit (V,) represents each."""
        out = np.zeros(sum(g.size for g in self.groups), dtype=np.int64)
        for group in self.groups:
            out[group] = rng.permuted(group[rng.permutation(len(group))], axis=1)
        return out


def _freedom(X: Floats, model: Floats, kept: Bools, pairs: Pairs, size: int) -> float:
    """Scalars that the first coefficient rests on; pairs that share a visit say partly the same."""
    A = X[kept] / (model[kept, None] / model.max())  # the scale cancels, and repeats that are copies leave nothing
    inverse = np.linalg.pinv(A.T @ A, rcond=1e-10)
    if abs(float(inverse[0] @ (A.T @ A)[:, 0]) - 1.0) > 1e-6:
        return 0.0  # the first column is a sum of the others
    share = inverse[0] @ A.T  # of each pair in the estimate, in units of its own variance
    visits = int(max(pairs.first.max(), pairs.second.max())) + 1
    at = np.bincount(pairs.first[kept], share, visits) + np.bincount(pairs.second[kept], share, visits)
    variance = 0.5 * float(share @ share) + 0.25 * float(at @ at)
    nugget = float((inverse @ (A.T @ np.ones(len(A))))[0])
    return size * nugget**2 / variance if variance > 0.0 else 0.0


def _half_square(residual: Floats, pairs: Pairs) -> Floats:
    return np.asarray(0.5 * np.mean((residual[pairs.first] - residual[pairs.second]) ** 2, axis=1))
