"""Drift: what all visits share while time passes or the temperature changes, and what only grows from visit to visit.

It moves every repeat by the same amount, so it can be taken out of repeats even where all of them are far apart in time.
What is left between them is noise.

Steady courses and waves that pass a test leave the finer half of a random walk, and it was called noise: 20 to 28 µm where
17 was right. Once a drift is certain, what is left of it is smoothed by as much as the repeats themselves ask for
(restricted maximum likelihood).

A base or an instrument that moves steadily moves every repeat by the same amount, so its motion can be taken out of the
repeats even where they are all far apart in time. What grows without such a pattern is distinguished from noise by a variogram.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import f

from kilter_core.gap.noise.variogram import (
    DRIFTED,
    KELVIN,
    QUICK,
    SPIKE,
    Pairs,
    chance_of_drift,
    fit_variogram,
    pair_visits,
    separable,
)
from kilter_core.gap.noise.visits import Visits
from kilter_core.observations.clock import read_clock
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

SCALARS_BESIDE_DRIFT = 9.0  # scalars that the noise must rest on beside a drift, for the two to count as distinguished
LENGTHS = 3
WAVES = 5  # half waves over the campaign: a random walk has nine tenths of its variance in them
MOST = 4  # clocks of one drift
SHOWN = 50  # places, and moments, at which the size of a drift is taken
TRIMS = 3
SEEN = 1e-9
WALK_WAVES = 40  # of a walk: all but 1/200 of its variance
WALK_WAVES_OF_LARGE = 15
LARGE = 1500  # visits from which fewer waves are taken
SHIFTS = 3  # of the motions, which come first
RATIOS = np.geomspace(1e-3, 1e6, 46)  # variance of the walk over that of the noise, tried to begin with
WALK_SEEN = 1e-10


@dataclass(frozen=True)
class Clocks:
    """What a drift may follow: time ``t (V,)`` steadily, in waves or settling, and the temperature ``kelvin (V,)``."""

    t: Floats
    kelvin: Floats | None

    def values(self, many: Bools) -> tuple[Floats, int]:
        """Clocks (C, V), from 0 to 1 or of that order, and how many are of time; temperature in K comes last."""
        span = float(np.ptp(self.t))
        u = (self.t - self.t.min()) / span if span > 0.0 else np.zeros(len(self.t))
        made = [u, np.exp(-u / QUICK), *(np.cos(np.pi * k * u) for k in range(2, WAVES + 1))] if span > 0.0 else []
        timed = len(made)
        if self.kelvin is not None and np.ptp(np.nan_to_num(self.kelvin)[many]) > KELVIN:
            made.append(np.nan_to_num(self.kelvin))
        return np.array(made).reshape(len(made), len(self.t)), timed


@dataclass(frozen=True)
class Shared:
    """Residuals ``left (V, m)`` without the drift that all visits share, where any was seen.

    ``freedom`` is how many scalars of the repeats are left to judge by, 0 for too few; ``vectors`` how many the drift took;
    ``moved`` is the rms change of a scalar over the campaign, ``per_kelvin`` that with the temperature.
    """

    left: Floats
    p_value: float
    freedom: float
    vectors: float
    moved: float
    per_kelvin: float

    @staticmethod
    def from_residuals(r: Floats, condition: Ints, clocks: Clocks, points: Floats | None) -> Shared:
        """Take one clock after another, the likeliest first, while chance does not explain it."""
        many = np.bincount(condition)[condition] > 1
        # One place for all visits of a condition: else what a wrong reading moved the place by would count as a motion.
        places = None if points is None else points - subtract_group_means(points, condition)
        size, motion = r.shape[1], _motions(len(r), r.shape[1], places)
        scalars = float(size * (many.sum() - len(np.unique(condition[many]))))
        each, timed = clocks.values(many)
        left, taken, first, amounts = r, 0.0, 1.0, np.zeros((len(each), motion.shape[2]))
        for step in range(MOST if len(each) else 0):
            if scalars - taken - motion.shape[2] < SCALARS_BESIDE_DRIFT:
                break
            tried = [_test_motion_along_clock(left, condition, many, motion, clock, scalars - taken) for clock in each]
            k = int(np.argmin([p for p, _ in tried]))
            p = min(1.0, tried[k][0] * len(each))
            first = p if step == 0 else first
            if p > DRIFTED:
                break
            amounts[k] += tried[k][1]
            left = left - (motion @ tried[k][1]) * (each[k] - each[k].mean())[:, None]
            taken += motion.shape[2]
        if first <= DRIFTED and timed:
            course = _courses(motion, each - each.mean(axis=1)[:, None], np.any(amounts, axis=1))
            without, walk = _without_walk(left, condition, many, motion, clocks.t, course)
            if scalars - taken - walk >= SCALARS_BESIDE_DRIFT:
                left, taken = without, taken + walk
        moved = _size(motion[many], amounts[:timed], each[:timed])
        warmth = motion[many] @ amounts[timed:].sum(axis=0)
        free = scalars - taken if scalars - motion.shape[2] >= SCALARS_BESIDE_DRIFT else 0.0
        return Shared(left, first, free, taken / size, moved, float(np.sqrt(np.mean(warmth**2))))


def moments_and_motions(condition: Ints, clocks: Clocks, points: Floats | None, size: int) -> Floats:
    """Columns (V, m, K) of a steady drift with time, and of one with the temperature, that all visits share."""
    places = None if points is None else points - subtract_group_means(points, condition)
    motion = _motions(len(condition), size, places)
    each, timed = clocks.values(np.bincount(condition)[condition] > 1)
    steady = each[[k for k in range(len(each)) if k == 0 or k >= timed]]
    return _courses(motion, steady, np.ones(len(steady), dtype=bool)) if len(steady) else motion[:, :, :0]


def _test_motion_along_clock(
    r: Floats, condition: Ints, many: Bools, motion: Floats, clock: Floats, scalars: float
) -> tuple[float, Floats]:
    """Chance of a motion along a clock, and its amount (k,), from the repeats without their spikes."""
    moved = motion * (clock - clock.mean())[:, None, None]
    columns = subtract_group_means(moved, condition)
    away, amount = subtract_group_means(r, condition), np.zeros(motion.shape[2])
    kept = many & _non_spike_mask(np.abs(away).max(axis=1), many)
    seen = np.sum(columns[many] ** 2, axis=(0, 1)) > SEEN * float(np.sum(moved**2)) + np.finfo(float).tiny
    if not seen.any():
        return 1.0, amount
    for _ in range(TRIMS):
        A = columns[kept][:, :, seen].reshape(-1, int(seen.sum()))
        amount[seen] = np.linalg.lstsq(A, away[kept].reshape(-1), rcond=SEEN)[0]
        rest = np.abs(away - columns @ amount).max(axis=1)
        kept = many & _non_spike_mask(rest, many)
    before, after = (float(np.sum(v[kept] ** 2)) for v in (away, away - columns @ amount))
    taken = float(seen.sum())
    free = scalars - taken - r.shape[1] * float(many.sum() - kept.sum())
    if free < 1.0 or after <= 0.0:
        return 1.0, amount
    return float(f.sf((before - after) / taken / (after / free), taken, free)), amount


def _courses(motion: Floats, each: Floats, followed: Bools) -> Floats:
    """Columns (V, m, c) of the motions along the clocks that were followed."""
    columns = motion[None] * each[followed][:, :, None, None]
    return np.asarray(columns.transpose(1, 2, 0, 3).reshape(*motion.shape[:2], -1))


def _without_walk(
    r: Floats, condition: Ints, many: Bools, motion: Floats, t: Floats, course: Floats
) -> tuple[Floats, float]:
    """Residuals (V, m) without a walk that all visits share, and how many scalars it took."""
    away = subtract_group_means(r, condition)
    kept = many & _non_spike_mask(np.abs(away).max(axis=1), many)
    kept &= np.bincount(condition[kept], minlength=int(condition.max()) + 1)[condition] > 1
    way, taken = fit_random_walk(away, motion, t, condition, kept, course)
    return r - way, taken


def _non_spike_mask(size: Floats, many: Bools) -> Bools:
    """Which sizes (V,) are not spikes among those of the repeats."""
    return np.asarray(size <= SPIKE * np.median(size[many]) / 0.6745)


def _size(motion: Floats, amounts: Floats, each: Floats) -> float:
    """Rms, over scalars and places, of the way from one end of the drift's course to the other."""
    if not len(each) or not np.any(amounts):
        return 0.0
    places = motion[:: max(1, len(motion) // SHOWN)]
    moments = each[:, :: max(1, each.shape[1] // SHOWN)]
    course = np.einsum("vmk,ck,ct->vmt", places, amounts, moments)
    return float(np.sqrt(np.mean(np.ptp(course, axis=2) ** 2)))


def _motions(count: int, size: int, points: Floats | None) -> Floats:
    """Motions (V, m, k) that visits may share: of points a shift, a rotation and a scale; else each scalar for itself."""
    if size % LENGTHS == 0 and size != 2 * LENGTHS:
        shift = np.tile(np.eye(LENGTHS), (size // LENGTHS, 1))[None].repeat(count, axis=0)
    else:
        shift = np.eye(size)[None].repeat(count, axis=0)
    if points is None or size != LENGTHS:
        return shift
    p = points - points.mean(axis=0)
    p = p / max(float(np.sqrt(np.mean(p**2))), SEEN)
    turn = np.cross(np.eye(LENGTHS)[None], p[:, None]).transpose(0, 2, 1)
    return np.concatenate([shift, turn, p[:, :, None]], axis=2)


def fit_random_walk(
    away: Floats, motion: Floats, t: Floats, condition: Ints, kept: Bools, course: Floats
) -> tuple[Floats, float]:
    """The way (V, m) of all visits by a walk, and how many scalars of the repeats it takes.

    It goes along the first ``m`` or along all of the motions ``motion (V, m, k)``, whichever is likelier, beside the steady
    ``course (V, m, c)`` that was found. ``away (V, m)`` are residuals less the mean of their condition; ``kept (V,)`` marks
    the repeats that are not spikes.
    """
    size = away.shape[1]
    scalars = float(size * (kept.sum() - len(np.unique(condition[kept]))))
    F = subtract_group_means(course, condition, kept)[kept].reshape(-1, course.shape[2])
    Q, size_of, turn = np.linalg.svd(F, full_matrices=False)
    seen = size_of > np.sqrt(WALK_SEEN) * max(float(size_of[0]), np.finfo(float).tiny)
    Q, back = Q[:, seen], turn[seen].T / size_of[seen]
    y = subtract_group_means(away, condition, kept)[kept].reshape(-1)
    y = y - Q @ (Q.T @ y)
    tried = []
    for count in {min(SHIFTS, motion.shape[2]), motion.shape[2]}:
        X = _walk_columns(motion[:, :, :count], t)
        Xc = subtract_group_means(X, condition, kept)[kept].reshape(-1, X.shape[2])
        along = Q.T @ Xc
        cost, amount, taken = _fit_wave_amplitudes(Xc - Q @ along, y, scalars - Q.shape[1])
        # What of the walk looks like the steady course went with that already.
        tried.append((cost, X @ amount - course @ (back @ (along @ amount)), taken))
    _, way, taken = min(tried, key=lambda one: one[0])
    return way, taken


def _fit_wave_amplitudes(X: Floats, y: Floats, scalars: float) -> tuple[float, Floats, float]:
    """Likelihood (less is likelier) of waves X (R, w), what they are likeliest to amount to, and how many scalars they take."""
    w, V = np.linalg.eigh(X.T @ X)
    able = w > WALK_SEEN * max(float(w[-1]), np.finfo(float).tiny)
    w, V = w[able], V[:, able]
    z = (V.T @ (X.T @ y)) / np.sqrt(w)
    cost, ratio = _likeliest(z**2, w, max(float(y @ y - z @ z), 0.0), scalars)
    return cost, V @ (z * ratio * np.sqrt(w) / (1.0 + ratio * w)), float(np.sum(ratio * w / (1.0 + ratio * w)))


def _walk_columns(motion: Floats, t: Floats) -> Floats:
    """Motions along the waves of a walk (V, m, k K), each as large as its share of the walk."""
    u = (t - t.min()) / max(float(np.ptp(t)), np.finfo(float).tiny)
    k = np.arange(1, (WALK_WAVES_OF_LARGE if len(t) > LARGE else WALK_WAVES) + 1) - 0.5
    wave = np.sqrt(2.0) * np.sin(np.pi * np.outer(u, k)) / (np.pi * k)
    return np.asarray((motion[:, :, :, None] * wave[:, None, None, :]).reshape(*motion.shape[:2], -1))


def _likeliest(z2: Floats, w: Floats, rest: float, scalars: float) -> tuple[float, float]:
    """Restricted likelihood (less is likelier), and the variance of the walk over that of the noise; 0 for no walk."""

    def cost(ratio: float) -> float:
        grown = 1.0 + ratio * w
        noise = max((float(np.sum(z2 / grown)) + rest) / scalars, np.finfo(float).tiny)
        return 0.5 * float(scalars * np.log(noise) + np.sum(np.log(grown)))

    costs = [cost(r) for r in RATIOS]
    best = int(np.argmin(costs))
    if cost(0.0) <= costs[best]:
        return cost(0.0), 0.0
    low, high = (np.log(RATIOS[max(best - 1, 0)]), np.log(RATIOS[min(best + 1, len(RATIOS) - 1)]))
    found = minimize_scalar(lambda x: cost(float(np.exp(x))), bounds=(low, high), method="bounded")
    return float(found.fun), float(np.exp(found.x))


SOON = 0.1  # of the campaign: repeats no further apart see little of a drift five times the noise


@dataclass(frozen=True)
class Drift:
    """How far repeats drifted beyond noise: rms difference of a coordinate over the campaign, and per K.

    ``p_value`` is the chance that stable repeats seem to. Without a clock ``timed`` is False: the order of rows was used.
    """

    over_campaign: float
    per_kelvin: float
    p_value: float
    timed: bool

    @property
    def is_significant(self) -> bool:
        """Whether the repeats drifted."""
        return self.p_value <= DRIFTED

    def to_document(self, unit: str, scale: float) -> dict[str, Any]:
        """Plain numbers, in mm or deg."""
        return {
            "seen": self.is_significant,
            f"over_campaign_{unit}": self.over_campaign * scale,
            f"per_kelvin_{unit}": self.per_kelvin * scale,
            "p_value": self.p_value,
            "timed": self.timed,
        }


@dataclass(frozen=True)
class Repeats:
    """Noise of visits from their repeats: deviations (P, m), each scaled to the noise, at ``index (P,)`` visits.

    ``variance (B,)`` of the scalars of each block (lengths and rotations of poses are two), resting on ``vectors``
    independent deviations. ``most`` says that it may hold drift: no more than this is noise.
    """

    deviation: Floats
    index: Ints
    variance: Floats
    vectors: float
    drift: Drift
    most: bool


def scalar_blocks(size: int, lengths: int | None) -> tuple[slice, ...]:
    """Scalars of one kind: of poses lengths and rotations."""
    return (slice(0, size),) if lengths is None else (slice(0, lengths), slice(lengths, size))


def visit_clocks(visits: Visits) -> tuple[Clocks, bool]:
    """Time and temperature of the visits, and whether the time is that of a clock and not the order of the rows."""
    rows = visits.observations
    clock = read_clock(rows)
    timed = rows.t is not None and clock.trusted
    return Clocks(rows.t if timed and rows.t is not None else _ranks(clock.order), rows.temperature_c), timed


def estimate_drift_free_noise(
    residual: Floats, visits: Visits, points: Floats | None, lengths: int | None, taken: float = 0.0
) -> Repeats | None:
    """Noise at no distance from residuals (V, m) of visits; None when no condition was visited twice.

    ``taken`` scalars of what they differ by were fitted away before.
    """
    clocks, timed = visit_clocks(visits)
    t, kelvin = clocks.t, clocks.kelvin
    pairs = pair_visits(visits.condition, t, kelvin)
    if not len(pairs):
        return None
    blocks = scalar_blocks(residual.shape[1], lengths)
    scaled = residual / _typical(residual, pairs, blocks)
    shared = Shared.from_residuals(scaled, visits.condition, clocks, points)
    left = shared.left
    chance = chance_of_drift(left, visits.condition, pairs)
    soon = residual.shape[1] * float(np.sum(pairs.dt <= SOON * np.ptp(t)))
    most = max(shared.freedom, soon, separable(pairs, residual.shape[1])) < SCALARS_BESIDE_DRIFT and bool(
        pairs.terms.shape[1]
    )
    made = _at_no_distance(left, pairs, blocks, chance <= DRIFTED)
    if made is None:  # all of it may be drift
        made, most = _at_no_distance(left, pairs, blocks, False), True
    assert made is not None
    deviation, index, variance, vectors, grown = made
    unit = _typical(residual, pairs, blocks)
    # What was fitted to the repeats also took from their scatter.
    contrasts = float(len(visits) - len(np.unique(visits.condition)))
    left_over = max(1.0 - (shared.vectors + taken / residual.shape[1]) / contrasts, 1.0 / contrasts)
    deviation, variance = deviation * unit, variance / left_over * np.array([unit[b.start] ** 2 for b in blocks])
    drift = Drift(
        float(np.hypot(shared.moved, grown[0])) * float(unit[0]),
        float(np.hypot(shared.per_kelvin, grown[1])) * float(unit[0]),
        min(chance, shared.p_value),
        timed,
    )
    return Repeats(deviation, index, variance, vectors * left_over, drift, most)


def _at_no_distance(
    left: Floats, pairs: Pairs, blocks: tuple[slice, ...], drifting: bool
) -> tuple[Floats, Ints, Floats, float, tuple[float, float]] | None:
    """Deviations, their visits, variances, vectors and growth by a variogram of each block; None when nothing is left."""
    found = [fit_variogram(left[:, b], pairs, drifting) for b in blocks]
    if drifting and any(v.freedom < SCALARS_BESIDE_DRIFT or v.nugget <= 0.0 for v in found):
        return None
    kept = np.logical_and.reduce([v.kept for v in found])
    deviation = (left[pairs.first] - left[pairs.second]) / np.sqrt(2.0)
    for v, b in zip(found, blocks, strict=True):
        deviation[:, b] *= np.sqrt(v.nugget / np.maximum(v.model, 1e-300))[:, None]
        kept &= v.model <= 2.0 * max(v.nugget, 1e-300)  # beyond, the difference is drift and its shape is the drift's
    vectors = min(v.freedom / (b.stop - b.start) for v, b in zip(found, blocks, strict=True))
    parts, time = found[0].parts, pairs.of_time
    grown = (0.0, 0.0)
    if drifting:
        warmest = float(pairs.dT.max(initial=0.0))
        heat = float(np.sum(parts[~time])) / max(warmest, KELVIN) ** 2
        grown = (float(np.sqrt(2.0 * np.sum(parts[time]))), float(np.sqrt(2.0 * heat)))
    return deviation[kept], pairs.first[kept], np.array([v.nugget for v in found]), vectors, grown


def _typical(residual: Floats, pairs: Pairs, blocks: tuple[slice, ...]) -> Floats:
    """A usual difference of each scalar's kind (m,): lengths and rotations are compared in these."""
    d = np.abs(residual[pairs.first] - residual[pairs.second])
    out = np.ones(residual.shape[1])
    for b in blocks:
        out[b] = max(float(np.median(d[:, b])) / 0.6745 / np.sqrt(2.0), 1e-12)
    return out


def _ranks(order: Ints) -> Floats:
    out = np.empty(len(order))
    out[order] = np.arange(len(order))
    return out
