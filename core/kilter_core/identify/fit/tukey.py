"""Identification with Tukey's loss: rows that cannot be of this arm are found and let go, not only weighed down.

Huber's loss bounds the pull of a wrong row; a seventh of the rows, all wrong alike, still pull the arm with them. From its
minimum the limit comes down until it holds the bulk of the rows only (`kilter_core.identify.fit.robust`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.identify.fit.least_squares import HUBER_SIGMAS, Fit, Problem, Weights, solve
from kilter_core.identify.fit.robust import Loss, Robust, descend_to_tukey_weights
from kilter_core.identify.fit.row_errors import mean_marker_error
from kilter_core.measurement import Residual
from kilter_core.parameters import mm
from kilter_core.types import Floats

ENOUGH = 1e-3  # share of the loss below which a step no longer changes which rows are let go
SET_ASIDE = 0.5  # rows that count less are named
SMALLEST = 1e-7  # m, rad: below any instrument


def row_dimension(problem: Problem) -> int:
    """Numbers of a row that are independent: three of a point, or of markers that move together, six of a pose."""
    if problem.measurement.observations.rotation is not None:
        return 6
    return 3 if problem.measurement.observes_places else 1


def row_sizes(fit: Fit) -> Floats:
    """Size (N,) of what a fit leaves of every row."""
    return whitened_row_sizes(fit.residual, fit.problem.weights.points, fit.problem.weights.turns)


def whitened_row_sizes(left: Residual, points: float | Floats, turns: float) -> Floats:
    """Size (N,) of what is ``left`` of every row: its length in standard deviations of a coordinate, ``points`` m.

    Rows show different numbers of markers: what counts is the mean square of the coordinates that were seen. Rotations are
    in standard deviations ``turns`` rad and count with the others.
    """
    scaled = left.points / points
    seen = ~np.isnan(scaled)
    each = np.where(seen, scaled, 0.0).reshape(len(scaled), -1)
    square = np.sum(each**2, axis=1) / np.maximum(seen.reshape(len(scaled), -1).sum(axis=1), 1)
    square *= scaled.shape[2]
    if left.turns is not None:
        square += np.sum((left.turns / turns) ** 2, axis=1)
    return np.asarray(np.sqrt(square))


def row_weights(fit: Fit) -> Floats:
    """How much each row counts (N,), from 0 to 1, by the loss of the fit."""
    if fit.problem.loss == "tukey" and fit.problem.weights.rows is not None:
        return fit.problem.weights.rows
    if fit.problem.loss != "huber" or len(fit.residual.points) != len(fit.problem.measurement.observations):
        return np.ones(len(fit.problem.measurement.observations))
    return Loss("huber", HUBER_SIGMAS).weight(row_sizes(fit))


def redescend(first: Fit) -> tuple[Fit, Robust]:
    """Go on from a fit with a bounded loss to one in which rows far from the bulk have no weight.

    Rows keep the ratio of their standard deviations; their common scale is read from the bulk.
    """
    fit = first

    def sizes(weight: Floats) -> Floats:
        nonlocal fit
        fit = solve(with_row_weights(fit.problem, weight), fit.values, None, None, ENOUGH)
        return row_sizes(fit)

    found = descend_to_tukey_weights(sizes, row_sizes(first), row_dimension(first.problem))
    weights = first.problem.weights
    points, turns = np.maximum(weights.points * found.scale, SMALLEST), max(weights.turns * found.scale, SMALLEST)
    others = {group: max(sigma * found.scale, SMALLEST) for group, sigma in weights.others.items()}
    scaled = Weights(float(points) if isinstance(weights.points, float) else points, turns, found.weight, others)
    problem = with_row_weights(fit.problem, found.weight).with_weights(scaled, first.problem.held)
    return solve(problem, fit.values), found


def set_aside(fit: Fit) -> list[dict[str, Any]]:
    """Rows that count less than half: ``row`` from 0, what is left of it (``residual_mm``, ``residual_sigma``), ``weight``.

    ``residual_mm`` is None where no point of the tool was measured.
    """
    weight = row_weights(fit)
    rows = np.flatnonzero(weight < SET_ASIDE)
    if not len(rows):
        return []
    size, seen = row_sizes(fit), fit.problem.measurement.observations
    placed = seen.position is not None or seen.markers is not None
    length = points_mm(fit.residual) if placed and len(fit.residual.points) == len(seen) else [None] * len(seen)
    return [
        {"row": int(k), "residual_mm": length[k], "residual_sigma": float(size[k]), "weight": float(weight[k])}
        for k in rows
    ]


def points_mm(left: Residual) -> list[float | None]:
    """How far (mm) the point of each row is from where a model says, of markers their mean; None where nothing was seen."""
    length = mm(np.asarray(np.linalg.norm(mean_marker_error(left.points), axis=1)))
    return [float(one) if np.isfinite(one) else None for one in length]


def with_row_weights(problem: Problem, weight: Floats) -> Problem:
    """The problem with a quadratic loss in which the rows have these weights (N,)."""
    weights = replace(problem.weights, rows=weight)
    return problem.with_weights(weights, problem.held, "tukey")
