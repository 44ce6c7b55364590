"""What repeats say of drift: parts that all visits share, and those that only grow from visit to visit.

A base or an instrument that moves steadily moves every repeat by the same amount, so its motion can be taken out of the
repeats even where they are all far apart in time. What grows without such a pattern is distinguished from noise by a variogram.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.gap.noise.shared_drift import SCALARS_BESIDE_DRIFT, Clocks, Shared
from kilter_core.gap.noise.variogram import (
    DRIFTED,
    KELVIN,
    Pairs,
    chance_of_drift,
    fit_variogram,
    pair_visits,
    separable,
)
from kilter_core.gap.noise.visits import Visits
from kilter_core.observations.clock import read_clock
from kilter_core.types import Floats, Ints

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
