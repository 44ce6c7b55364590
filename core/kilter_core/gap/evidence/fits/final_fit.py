"""What the last fit says, the one that a version stores: how far its noise is widened, its amounts, their covariance.

Scores of a search project the geometry off, without its priors. Where the base moved by an effect no longer imitates the
first joint's zero, that leaves a direction free which the priors hold: a station that moved by 5 mm was told with 0.35 mm
along x, while the version held 4.5 mm. So nothing that is told of a named effect comes from scores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.sources.source import Source
from kilter_core.model import Calibration
from kilter_core.parameters import Prior, indices
from kilter_core.types import Floats

UNHELD = 1e-8  # of the information of a prior: what is left of it where rows are asked alone
SMALLEST = 1e-9  # inflation of a fit that leaves nothing, as of simulations without noise


@dataclass(frozen=True)
class Amounts:
    """Named parameters of the last fit (SI, in the order of the search's columns): ``values (d,)`` as stored.

    ``wanted (d,)`` is what the rows ask for where physical ranges hold an amplitude; ``covariance (d, d)`` is within all
    priors, inflated by what noise leaves unexplained.
    """

    values: Floats
    wanted: Floats
    covariance: Floats


def final_effect_amounts(found: SearchResult) -> Amounts:
    """Amounts of all that was named, geometry and the rest as uncertain as the version says."""
    problem, columns = found.problem, found.columns
    source = problem.settings.source
    values = source.library(problem.values)[columns]
    J, prior, covariance = jacobian_prior_covariance(found)
    away = prior.standardized_deviation(np.concatenate([source.geometry(problem.values), values]))
    grown = widening(found)
    B = J * (grown * prior.sigma)
    H = B.T @ B
    prior.add_to(H)
    step = np.linalg.solve(H, B.T @ problem.raw - prior.stiff(away)) * prior.sigma
    own = slice(len(source.prior_mean), None)
    return Amounts(values, values + step[own], covariance[own, own])


def by_rows(found: SearchResult) -> tuple[Floats, Floats]:
    """Sizes (d,) of the named parameters that the rows ask for whatever their priors say, and their standard deviations.

    The geometry keeps its own priors. Those that the rows do not tell from one another are as uncertain as that makes them.
    """
    problem, columns = found.problem, found.columns
    source, library = problem.settings.source, problem.settings.source.library_sigma[columns]
    J = np.hstack([source.prior.columns(problem.G), problem.W_raw[:, columns] * (problem.size[columns] * library)])
    away = np.concatenate(
        [
            source.prior.whiten_deviation(source.prior.standardized_deviation(source.geometry(problem.values))),
            np.zeros(len(columns)),
        ]
    )
    weight = np.concatenate([np.ones(len(source.prior_mean)), np.full(len(columns), UNHELD)])
    H = J.T @ J + np.diag(weight)
    covariance = np.linalg.inv(H)
    own = slice(len(source.prior_mean), None)
    step = (covariance @ (J.T @ problem.raw - weight * away))[own] * library
    deviation = np.sqrt(np.maximum(np.diag(covariance)[own], 0.0)) * library * widening(found)
    return np.abs(source.library(problem.values)[columns] + step), deviation


def jacobian_prior_covariance(found: SearchResult) -> tuple[Floats, Prior, Floats]:
    """Whitened Jacobian (R, F), prior (F,) and covariance (F, F) of the geometry and the named effects."""
    problem, columns = found.problem, found.columns
    source = problem.settings.source
    J = problem.of_unit(columns) / widening(found)
    prior = source.prior_with_columns(columns)
    H = (J * prior.sigma).T @ (J * prior.sigma)
    prior.add_to(H)
    return J, prior, np.linalg.inv(H) * np.outer(prior.sigma, prior.sigma)


def inflation(search: SearchResult) -> float:
    """Factor on standard deviations for what noise leaves unexplained; without a scale of its own, the scale of the fit."""
    left = search.problem.gram.condition_on_columns(search.columns)
    ratio = left.yy / max(left.nu, 1.0)
    return float(np.sqrt(max(1.0, ratio) if search.problem.settings.trusted else ratio))


def widening(found: SearchResult) -> float:
    """The same, never zero: what residuals may be divided by."""
    return max(inflation(found), SMALLEST)


def amounts(search: SearchResult, columns: Sequence[int], X: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Amounts (K,) of unit library ``columns`` within their priors, and their covariance (K, K).

    ``X (R, K)`` are their whitened derivatives in the data ``y (R,)`` asked, all else taken out of both.
    """
    problem, index = search.problem, list(columns)
    prior = np.maximum(problem.settings.source.library_sigma[index] * problem.size[index], 1e-300)
    variance = search.selector.variance(problem.gram, search.chosen)
    covariance = np.asarray(np.linalg.inv(X.T @ X / variance + np.diag(1.0 / prior**2)), dtype=np.float64)
    return covariance @ (X.T @ y) / variance, covariance


@dataclass(frozen=True)
class Posterior:
    """Covariance ``(F, F)`` SI of the free parameters ``names``, in the order of the version that holds them.

    ``prior_sigma (F,)`` are the widths of their priors. ``J (R, F)`` is the whitened Jacobian, None for joint data, where
    an offset of each motion is added to every joint's zero.
    """

    names: tuple[str, ...]
    covariance: Floats
    prior_sigma: Floats
    J: Floats | None

    @property
    def sigma(self) -> Floats:
        """Standard deviations (F,)."""
        return np.sqrt(np.diag(self.covariance))


def posterior(found: SearchResult, begin: Calibration, stored: Calibration) -> Posterior:
    """Posterior at the end of a search that started at ``begin`` and stores ``stored``.

    The noise is inflated by what it leaves unexplained, as for the amplitudes.
    """
    source = found.problem.settings.source
    J, prior, covariance = jacobian_prior_covariance(found)
    names, L = _map_to_stored_parameters(source, begin, stored, found.columns)
    seen = J @ L.T if source.observes_tool else None
    return Posterior(names, L @ covariance @ L.T, np.sqrt(np.sum(prior.columns(L) ** 2, axis=1)), seen)


def _map_to_stored_parameters(
    source: Source, begin: Calibration, stored: Calibration, columns: list[int]
) -> tuple[tuple[str, ...], Floats]:
    """Names (F,) of the stored free parameters, in the stored order, and how they follow (F, P + d) from what was fitted."""
    model = source.model
    library = [model.names[len(model.names) - source.n_library + k] for k in columns]
    fitted = [*source.fitted_names(), *library]
    rows = dict(source.follows(begin, len(fitted)))
    # A version without load effects has no load errors either: what the data say of masses is then nothing.
    known = set(stored.names)
    rows |= {name: np.eye(len(fitted))[k] for k, name in enumerate(fitted) if name is not None and name in known}
    order = sorted(rows, key=lambda name: int(indices(stored.names, [name])[0]))
    return tuple(order), np.array([rows[name] for name in order]).reshape(len(order), len(fitted))
