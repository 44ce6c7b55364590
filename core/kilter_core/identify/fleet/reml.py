"""Mean and covariance of the arms of a type from a version of each: restricted maximum likelihood, and shrinkage.

Each version knows its own parameters with a covariance of its own, so what versions differ by is two things: what arms
differ by, and what their fits do not know. Restricted likelihood (Patterson and Thompson 1971; Harville 1977) tells them
apart without the bias of having estimated the mean, and expectation-maximisation (Laird and Ware 1982) climbs it without
ever leaving covariances. A few arms cannot say how dozens of parameters correlate: the covariance is drawn towards a
diagonal one, as an inverse Wishart prior of ``K`` arms would, whose variances are in turn drawn towards what parameters of
the same unit have in common (Smyth 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.types import Floats, Ints

ROUNDS = 500
SETTLED = 1e-4  # largest change of a standard deviation, as a share of it, that ends the climb
COMMON = 4.0  # arms that what parameters of one unit have in common counts for
FLOOR = 1e-6  # of the width of its ordinary prior that a parameter spreads by at least: arms are never exactly alike


@dataclass(frozen=True)
class Population:
    """Arms of a type: ``mean (K,)``, how well it is known ``mean_covariance (K, K)``, and ``between (K, K)``, their spread."""

    mean: Floats
    mean_covariance: Floats
    between: Floats

    @property
    def of_another(self) -> Floats:
        """Covariance (K, K) of one more arm about the mean."""
        return self.between + self.mean_covariance


def population(values: Floats, within: Floats, groups: Ints, strength: float | None = None) -> Population:
    """Estimate a type from ``values (n, K)`` of n arms and the covariances ``within (n, K, K)`` of their fits.

    All are in widths of ordinary priors. ``groups (K,)`` number the units; ``strength`` is the number of arms that the
    diagonal target counts for, K when None; 0 leaves plain restricted likelihood.
    """
    count, size = values.shape
    weight = float(size) if strength is None else strength
    between = np.diag(np.maximum(np.var(values, axis=0, ddof=1), FLOOR**2))
    for _ in range(ROUNDS):
        before = np.sqrt(np.diag(between))
        between = _shrunk(_expected_scatter(values, within, between), count, groups, weight)
        after = np.sqrt(np.diag(between))
        if np.max(np.abs(after - before) / after) < SETTLED:
            break
    return Population(*_mean(values, within, between), between)


def _mean(values: Floats, within: Floats, between: Floats) -> tuple[Floats, Floats]:
    """Mean (K,) by generalised least squares, and its covariance (K, K)."""
    weights = np.linalg.inv(within + between)
    covariance = np.linalg.inv(weights.sum(axis=0))
    return np.asarray(covariance @ np.einsum("nij,nj->i", weights, values)), np.asarray(covariance)


def _expected_scatter(values: Floats, within: Floats, between: Floats) -> Floats:
    """Sum (K, K) over the arms of the expected products of their deviations, the mean's own doubt included."""
    weights: Floats = np.asarray(np.linalg.inv(within + between), dtype=np.float64)
    mean, covariance = _mean(values, within, between)
    deviations = np.einsum("ij,njk,nk->ni", between, weights, values - mean)
    unseen = (
        len(values) * between - between @ (weights.sum(axis=0) - _weights_lost_to_mean(weights, covariance)) @ between
    )
    return np.asarray(deviations.T @ deviations + unseen)


def _weights_lost_to_mean(weights: Floats, covariance: Floats) -> Floats:
    """What estimating the mean takes from the weights (K, K)."""
    return np.asarray(np.einsum("nij,jk,nkl->il", weights, covariance, weights, optimize=True))


def _shrunk(products: Floats, count: int, groups: Ints, weight: float) -> Floats:
    """Covariance (K, K) from summed products, drawn towards a diagonal whose variances are drawn towards their unit's."""
    own = np.maximum(np.diag(products) / count, FLOOR**2)
    common = (np.bincount(groups, own) / np.maximum(np.bincount(groups), 1))[groups]
    target = np.diag((count * own + COMMON * common) / (count + COMMON))
    made = (products + weight * target) / (count + weight)
    made.flat[:: len(made) + 1] = np.maximum(np.diag(made), FLOOR**2)
    return np.asarray(0.5 * (made + made.T))
