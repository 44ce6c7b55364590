"""Robust weights on sizes of residuals: losses, scales, a start that survives wrong rows, and what that costs.

A size is the length of one residual of ``dimension`` independent coordinates, in any unit. Huber's loss bounds what a wrong
row can pull; Tukey's lets go of it altogether, but only from a start and a scale that the wrong rows did not make. So the
limit comes down from far outside, and the scale is read from the bulk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, gammaincinv

from kilter_core.types import Floats

EFFICIENCY = 0.95  # of the fit where no row is wrong
COARSEST = 4.0  # times the last limit at which the descent begins, at least
STEP = 0.7  # factor on the limit from one pass to the next
FARTHEST = 12.0  # the same at most: beyond, a row is wrong whatever the first fit was bent by
STILL = 1e-2  # change of weights that ends the descent
SETTLED = 1e-3  # the same of a scale
PASSES = 40
BULK = 3.0  # scales within which the final scale is read
SMALLEST = 1e-12


@dataclass(frozen=True)
class Loss:
    """A loss of a size: ``kind`` "huber" or "tukey", with its ``limit`` in the unit of the sizes."""

    kind: str
    limit: float

    def weight(self, size: Floats) -> Floats:
        """Weight of each residual in the normal equations: psi(size) / size."""
        if self.kind == "huber":
            return np.asarray(self.limit / np.maximum(size, self.limit))
        return np.asarray(np.maximum(1.0 - (size / self.limit) ** 2, 0.0) ** 2)

    def rho(self, size: Floats) -> Floats:
        """Loss of each residual: size² / 2 near zero."""
        c = self.limit
        if self.kind == "huber":
            return np.asarray(np.where(size <= c, 0.5 * size**2, c * (size - 0.5 * c)))
        return np.asarray((1.0 - np.maximum(1.0 - (size / c) ** 2, 0.0) ** 3) * c**2 / 6.0)

    def slope(self, size: Floats) -> Floats:
        """Derivative of psi."""
        if self.kind == "huber":
            return np.asarray((size <= self.limit).astype(np.float64))
        u = (size / self.limit) ** 2
        return np.asarray(np.where(u < 1.0, (1.0 - u) * (1.0 - 5.0 * u), 0.0))


@dataclass(frozen=True)
class Robust:
    """What a robust descent ends with: ``weight (N,)``, ``size (N,)`` and the ``scale`` of one coordinate of the bulk."""

    weight: Floats
    size: Floats
    scale: float


@lru_cache
def tukey_limit(dimension: int, efficiency: float = EFFICIENCY) -> float:
    """Limit of Tukey's loss, in standard deviations of a coordinate, for this efficiency on normal residuals."""
    sizes = np.sqrt(2.0 * gammaincinv(dimension / 2.0, (np.arange(4000) + 0.5) / 4000.0))
    low, high = 1.0, 30.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        worse = 1.0 / covariance_factor(sizes, dimension, Loss("tukey", middle), 0) < efficiency
        low, high = (middle, high) if worse else (low, middle)
    return high


def median_scale(size: Floats, dimension: int) -> float:
    """Standard deviation of one coordinate, from the median of the sizes: half of them may be wrong."""
    return float(np.median(size) / np.sqrt(2.0 * gammaincinv(dimension / 2.0, 0.5))) if len(size) else 0.0


def bulk_scale(size: Floats, dimension: int, first: float) -> float:
    """The same from all sizes that belong to the bulk, whose tail is cut where ``first`` and its successors say."""
    scale = first
    # Sizes of many coordinates are all far from zero: the cut is at the same chance as BULK of one coordinate is.
    cut = float(np.sqrt(chdtri(dimension, chdtrc(1, BULK**2))))
    kept_share = chdtr(dimension + 2, cut**2) / chdtr(dimension, cut**2)
    for _ in range(PASSES):
        inside = size <= cut * max(scale, SMALLEST)
        if not inside.any():
            break
        before, scale = scale, float(np.sqrt(np.mean(size[inside] ** 2) / (dimension * kept_share)))
        if abs(scale - before) <= SETTLED * scale:
            break
    return scale


def never_stop_early(size: Floats) -> bool:
    """Say that the descent goes on until its weights are still."""
    return False


def descend_to_tukey_weights(
    sizes: Callable[[Floats], Floats],
    start: Floats,
    dimension: int,
    decided: Callable[[Floats], bool] = never_stop_early,
) -> Robust:
    """Tukey weights by a descent from a limit that holds every row to one that holds the bulk.

    ``sizes(weight)`` fits with weights (N,) and returns the sizes (N,) that are left; ``start (N,)`` are those of a first
    fit, at best one with a bounded loss. The same rows give the same weights. A third of the rows may be wrong, also alike.
    ``decided(size)`` is asked after every fit at the last limit: whether what the sizes are wanted for needs no more.
    """
    final = tukey_limit(dimension)
    size, weight = start, np.ones(len(start))
    farthest = float(start.max(initial=0.0)) / max(final * median_scale(start, dimension), SMALLEST)
    coarse = min(max(COARSEST, farthest), FARTHEST)
    for _ in range(PASSES):
        scale = max(median_scale(size, dimension), SMALLEST)
        if coarse <= 1.0:
            scale = max(bulk_scale(size, dimension, scale), SMALLEST)
        after = Loss("tukey", max(coarse, 1.0) * final * scale).weight(size)
        still = coarse <= 1.0 and float(np.abs(after - weight).max(initial=0.0)) < STILL
        weight = after
        if still:
            break
        size, last, coarse = sizes(weight), coarse <= 1.0, coarse * STEP
        if last and decided(size):
            break
    return Robust(weight, size, bulk_scale(size, dimension, median_scale(size, dimension)))


def covariance_factor(size: Floats, dimension: int, loss: Loss, parameters: int) -> float:
    """Huber's factor on (JᵀJ)⁻¹ of the *unweighted* Jacobian, in squared units of the sizes.

    The scatter of psi over its mean slope, squared, with his correction for ``parameters`` fitted to so few residuals.
    The weighted normal matrix alone is not a covariance: it counts a row by its weight, and the weights fit the residuals.
    """
    weight = loss.weight(size)
    bend = (1.0 - 1.0 / dimension) * weight + loss.slope(size) / dimension
    count, mean = len(size) * dimension, float(np.mean(bend))
    if mean <= 0.0 or count <= parameters:
        return np.inf
    correction = 1.0 + parameters / count * float(np.var(bend)) / mean**2
    return float(correction**2 * np.sum((weight * size) ** 2) / (count - parameters) / mean**2)
