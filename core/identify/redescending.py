"""Identification with Tukey's loss: rows that cannot be of this arm are found and let go, not only weighed down.

Huber's loss bounds the pull of a wrong row; a seventh of the rows, all wrong alike, still pull the arm with them. From its
minimum the limit comes down until it holds the bulk of the rows only (`core.identify.robust`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.identify.least_squares import Fit, Problem, Weights, solve
from core.identify.robust import Robust, redescended

Floats = NDArray[np.float64]

ENOUGH = 1e-3  # share of the loss below which a step no longer changes which rows are let go
SMALLEST = 1e-7  # m, rad: below any instrument


def dimension_of(problem: Problem) -> int:
    """Numbers of a row that are independent: three of a point, or of markers that move together, six of a pose."""
    if problem.measurement.observations.rotation is not None:
        return 6
    return 3 if problem.measurement.sees_base else 1


def row_sizes(fit: Fit) -> Floats:
    """Size (N,) of what is left of every row, in standard deviations of a coordinate times the root of its numbers.

    Rows show different numbers of markers: what counts is the mean square of the coordinates that were seen.
    """
    weights = fit.problem.weights
    points = fit.residual.points / weights.points
    seen = ~np.isnan(points)
    each = np.where(seen, points, 0.0).reshape(len(points), -1)
    square = 3.0 * np.sum(each**2, axis=1) / np.maximum(seen.reshape(len(points), -1).sum(axis=1), 1)
    if points.shape[2] == 1:
        square /= 3.0
    if fit.residual.turns is not None:
        square += np.sum((fit.residual.turns / weights.turns) ** 2, axis=1)
    return np.asarray(np.sqrt(square))


def redescend(first: Fit) -> tuple[Fit, Robust]:
    """Go on from a fit with a bounded loss to one in which rows far from the bulk have no weight.

    Rows keep the ratio of their standard deviations; their common scale is read from the bulk.
    """
    fit = first

    def sizes(weight: Floats) -> Floats:
        nonlocal fit
        fit = solve(weighed(fit.problem, weight), fit.values, None, None, ENOUGH)
        return row_sizes(fit)

    found = redescended(sizes, row_sizes(first), dimension_of(first.problem))
    weights = first.problem.weights
    scaled = Weights(np.maximum(weights.points * found.scale, SMALLEST), max(weights.turns * found.scale, SMALLEST),
                     found.weight)  # fmt: skip
    if isinstance(weights.points, float):
        scaled = Weights(float(scaled.points), scaled.turns, found.weight)
    problem = weighed(fit.problem, found.weight).reweighted(scaled, first.problem.held)
    return solve(problem, fit.values), found


def weighed(problem: Problem, weight: Floats) -> Problem:
    """The problem with a quadratic loss in which the rows have these weights (N,)."""
    weights = Weights(problem.weights.points, problem.weights.turns, weight)
    return problem.reweighted(weights, problem.held, "tukey")
