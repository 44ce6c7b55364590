"""Robust weights on sizes of residuals: losses, scales, a start that survives wrong rows, and what that costs.

A size is the length of one residual of ``dimension`` independent coordinates, in any unit. Huber's loss bounds what a wrong
row can pull; Tukey's lets go of it altogether, but only from a start and a scale that the wrong rows did not make. So the
limit comes down from far outside, and the scale is read from the bulk.

Identification with Tukey's loss: rows that cannot be of this arm are found and let go, not only weighed down.

Huber's loss bounds the pull of a wrong row; a seventh of the rows, all wrong alike, still pull the arm with them. From its
minimum the limit comes down until it holds the bulk of the rows only (`kilter_core.identify.fit.robust`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, gammaincinv

from kilter_core.arm.chain import increment
from kilter_core.identify.fit.least_squares import HUBER_SIGMAS, Fit, Problem, Weights, solve
from kilter_core.measurement import Measurement, Residual
from kilter_core.model import Calibration
from kilter_core.parameters import mm
from kilter_core.transforms import inverse
from kilter_core.types import Floats, Ints

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


ENOUGH = 1e-3  # share of the loss below which a step no longer changes which rows are let go
SET_ASIDE = 0.5  # rows that count less are named
SMALLEST_SCALE = 1e-7  # m, rad: below any instrument


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
    points, turns = (
        np.maximum(weights.points * found.scale, SMALLEST_SCALE),
        max(weights.turns * found.scale, SMALLEST_SCALE),
    )
    others = {group: max(sigma * found.scale, SMALLEST_SCALE) for group, sigma in weights.others.items()}
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


FITTED = "identified"


@dataclass(frozen=True)
class RowErrors:
    """Errors by stage, measured minus predicted.

    Of measured points, ``left`` has (N, 3) m in the axes of the robot's base, the mean of a row's markers, NaN where none
    was seen; ``rows (N,)`` are their numbers from 0 and ``at (N, 3)`` m where the identified model has the tool in the
    robot's base frame. Distances and contacts are between rows: ``left`` has (K, 1) m, and ``rows`` and ``at`` are None.
    """

    left: Mapping[str, Floats]
    rows: Ints | None = None
    at: Floats | None = None

    @staticmethod
    def from_stages(stages: Mapping[str, Calibration], measurement: Measurement, rows: Ints) -> RowErrors:
        """Errors of calibrations on a measurement whose rows have these numbers."""
        if not measurement.observes_places:
            return RowErrors({name: measurement.errors(stage)[0] for name, stage in stages.items()})
        model, values = stages[FITTED].model, stages[FITTED].values
        base = inverse(model.T_base @ increment(values[:6]))
        predicted = stages[FITTED].predict(measurement.observations).position
        left = {name: _mean(stage, measurement) @ base[:3, :3].T for name, stage in stages.items()}
        return RowErrors(left, rows, predicted @ base[:3, :3].T + base[:3, 3])

    @staticmethod
    def concatenate(parts: Sequence[RowErrors]) -> RowErrors:
        """Pool folds, or set-ups of an instrument."""
        left = {name: np.concatenate([p.left[name] for p in parts]) for name in parts[0].left}
        rows, places = [p.rows for p in parts if p.rows is not None], [p.at for p in parts if p.at is not None]
        if len(rows) != len(parts) or len(places) != len(parts):
            return RowErrors(left)
        return RowErrors(left, np.concatenate(rows), np.concatenate(places))

    def with_row_numbers(self, numbers: Ints | None) -> RowErrors:
        """The same rows by their numbers among all that were given; as they are with None."""
        return self if self.rows is None or numbers is None else replace(self, rows=numbers[self.rows])

    @property
    def sizes(self) -> dict[str, Floats]:
        """Length (N,) m of what is left, by stage; rows without a measured point are left out."""
        out = {name: np.linalg.norm(e, axis=1) for name, e in self.left.items()}
        return {name: size[~np.isnan(size)] for name, size in out.items()}


def _mean(stage: Calibration, measurement: Measurement) -> Floats:
    """Error (N, 3) m of each row in the frame of the measurements: of its point, or the mean of the markers it shows."""
    return mean_marker_error(measurement.residual(stage.predict(measurement.observations)).points)


def mean_marker_error(points: Floats) -> Floats:
    """Mean (N, 3) of what markers (N, m, 3) are off by, over those that a row shows; NaN where it shows none."""
    seen = np.asarray(~np.isnan(points).any(axis=2))
    count = np.where(seen.any(axis=1), seen.sum(axis=1), np.nan)
    return np.asarray(np.where(seen[:, :, None], points, 0.0).sum(axis=1) / count[:, None])
