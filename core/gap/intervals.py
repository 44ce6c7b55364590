"""How large (E9): profile likelihood of each amplitude, geometry and other effects re-optimised at every value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from core.gap.hunt import Hunt
from core.gap.world import fitted, solved

Floats = NDArray[np.float64]

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


def amplitudes(hunt: Hunt, tell: Callable[[float], None]) -> dict[int, Amplitude]:
    """Amplitude of every chosen column, inflated by what noise leaves unexplained: max(1, chi²/nu)."""
    world, columns = hunt.world, hunt.columns
    if not columns:
        return {}
    left = world.gram.given(columns)
    absolute, grown = world.setting.trusted, inflation(hunt)
    # The scale is known as well as the repeats know it, or as what is left does when there are none.
    noise = world.setting.noise
    known = (noise.freedom if noise.absolute else np.inf) if absolute else left.nu
    width = float(t.isf((1 - LEVEL) / 2, max(known, 1.0)))
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
