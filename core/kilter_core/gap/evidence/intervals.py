"""How large (E9): profile likelihood of each amplitude, geometry and other effects re-optimised at every value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from kilter_core.gap.search.hunt import Hunt
from kilter_core.gap.search.source import LinkSource, ToolSource
from kilter_core.gap.search.tails import tail
from kilter_core.gap.search.world import fitted, solved

LEVEL = 0.95
MOST_ROWS = 3000  # scalars above which the likelihood is so narrow that its own curvature cannot matter
MOST_PROFILES = 16


@dataclass(frozen=True)
class Amplitude:
    """A parameter of a named effect (SI): value, standard deviation, 95 % interval; conditional on the library."""

    column: int
    value: float
    sigma: float
    low: float
    high: float

    @property
    def seen(self) -> bool:
        """Whether the data show it: its own interval does not hold zero."""
        return not self.low <= 0.0 <= self.high


def amplitudes(hunt: Hunt, tell: Callable[[float], None]) -> dict[int, Amplitude]:
    """Amplitude of every chosen column, inflated by what noise leaves unexplained: max(1, chi²/nu)."""
    world, columns = hunt.world, hunt.columns
    if not columns:
        return {}
    left = world.gram.given(columns)
    grown, width = inflation(hunt), interval_width(hunt)
    values, covariance = fitted(world, columns)
    out = {}
    for n, k in enumerate(columns):
        tell(n / len(columns))
        sigma = float(np.sqrt(covariance[n, n])) * grown
        low, high = (values[n] + side * width * sigma for side in (-1.0, 1.0))
        if world.rows <= MOST_ROWS and n < MOST_PROFILES and sigma > 0.0:
            low, high = (_end(hunt, k, float(values[n]), float(end), left.yy, width * grown) for end in (low, high))
        out[k] = Amplitude(k, float(values[n]), sigma, float(low), float(high))
    return out


def interval_width(hunt: Hunt) -> float:
    """Standard deviations from the middle of a 95 % interval to its ends."""
    return float(t.isf((1 - LEVEL) / 2, max(scale_freedom(hunt), 1.0)))


def scale_freedom(hunt: Hunt) -> float:
    """Numbers that the scale of the noise rests on: those of the repeats, or what is left where there are none."""
    noise = hunt.world.setting.noise
    if not hunt.world.setting.trusted:
        return hunt.world.gram.given(hunt.columns).nu
    return noise.freedom if noise.absolute else np.inf


def inflation(hunt: Hunt) -> float:
    """Factor on standard deviations for what noise leaves unexplained; without a scale of its own, the scale of the fit."""
    left = hunt.world.gram.given(hunt.columns)
    ratio = left.yy / max(left.nu, 1.0)
    return float(np.sqrt(max(1.0, ratio) if hunt.world.setting.trusted else ratio))


def _end(hunt: Hunt, k: int, best: float, end: float, least: float, target: float) -> float:
    """End of the profile interval: where chi-square has risen by ``target``², one secant step from the linear end."""
    others = [c for c in hunt.columns if c != k]
    rise = solved(hunt.world.setting, hunt.world.values, others, (k, end))[1] - least
    if rise <= 0.0:
        return end
    return best + (end - best) * float(np.clip(target / np.sqrt(rise), 0.5, 2.0))


def seen_joints(hunt: Hunt, place: int) -> tuple[tuple[int, ...] | None, bool]:
    """Joints at which the data show a chosen candidate (None: it acts at none), and whether they show any of it.

    The parameters of a joint are judged together: sine and cosine of a short range are each uncertain, and the curve is not.
    """
    candidate, columns = hunt.selector.scorer.candidates[place], hunt.columns
    source = hunt.world.setting.source
    assert isinstance(source, ToolSource | LinkSource)
    values, covariance = fitted(hunt.world, columns)
    wide, freedom = covariance * inflation(hunt) ** 2, scale_freedom(hunt)

    def shown(own: Sequence[int]) -> bool:
        index = [columns.index(k) for k in own]
        size = values[index] @ np.linalg.pinv(wide[np.ix_(index, index)], hermitian=True) @ values[index]
        return bool(tail(size, len(index), freedom) < 1.0 - LEVEL)

    if candidate.joints is None:
        return None, shown(candidate.columns)
    joints, start = set[int](), 0
    for effect in candidate.effects:
        own = candidate.columns[start : start + len(effect.parameters(source.model.robot))]
        start += len(own)
        joints |= set(effect.joints or ()) if shown(own) else set()
    return tuple(j for j in candidate.joints if j in joints), bool(joints)
