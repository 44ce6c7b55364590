"""The share of an approach that no repeat shows: how the noise is shaped where visits were read several times and not repeated.

Readings of a tracker scatter most across its line of sight, and how the arm comes to rest scatters alike in all
directions. By the shape of the readings alone a visit weighs too much along that line, and the test takes what the
approach did there for an effect. By their size alone priors would count for nothing beside the rows: masses known to
10 % were fitted 9 of their standard deviations away, to take up what the arm did from one approach to the next.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from kilter_core.gap.noise.covariances import SMALLEST
from kilter_core.types import Bools, Floats

LEAST = 1e-4  # of the variance of the readings: an approach that is smaller changes no weight
MOST = 1e4  # one that is larger makes all coordinates weigh alike
SETTLED = 1e-2  # of the logarithm of that ratio


def of_approach(readings: Floats, residual: Floats, used: Bools, lost: float, blocks: Sequence[slice]) -> Floats:
    """Variances (m,) of the approach beside the covariance ``readings (V, m, m)`` of visits: one for each of the ``blocks``.

    It is the likeliest by what a fit leaves, ``residual (V, m)`` of the visits ``used (V,)``, of whose freedom
    it took the share ``lost``; what a model lacks counts as approach until it is named.
    """
    out = np.zeros(readings.shape[-1])
    for block in blocks:
        own = readings[:, block, block]
        width = own.shape[-1]
        w, V = np.linalg.eigh(own[used] + SMALLEST**2 * np.eye(width))
        z = np.einsum("vij,vi->vj", V, np.nan_to_num(residual[used][:, block]))
        typical = float(np.mean(w))
        out[block] = typical * _ratio(w / typical, z**2 / (typical * (1.0 - lost)))
    return out


def _ratio(w: Floats, square: Floats) -> float:
    """Likeliest variance of the approach beside those of the readings ``w (V, m)``, by the squares (V, m) of what is left."""

    def loss(log: float) -> float:
        total = w + np.exp(log)
        return float(np.sum(np.log(total) + square / total))

    found = minimize_scalar(loss, bounds=(np.log(LEAST), np.log(MOST)), method="bounded", options={"xatol": SETTLED})
    nothing = float(np.sum(np.log(w) + square / w))
    return float(np.exp(found.x)) if found.fun < nothing else 0.0
