"""Weighted nonlinear least squares of a model: Levenberg and Marquardt on its exact Jacobian, with robust losses."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from kilter_core.effects import Batch
from kilter_core.errors import NotConvergedError
from kilter_core.identify.fit.problem import ByDeviation, LeastSquares, Whitened, linearised_residual
from kilter_core.identify.fit.solver import BEND, Minimum, StepProgress, minimise
from kilter_core.measurement import Block, Measurement, Residual
from kilter_core.measurement.kind import POINTS, TURNS, Spanned
from kilter_core.model import Calibration, RobotModel
from kilter_core.parameters import Prior
from kilter_core.types import Floats, Ints


@dataclass(frozen=True)
class PriorUse:
    """What became of a prior: ``widened_by`` times its standard deviations it was taken, None where it was dropped.

    ``odd`` parameters are those of which the arm is not as its type: there the rows alone say. ``chi_square`` compares the
    arm with its type in ``compared`` directions that the rows tell, the odd left to them, with the chance ``p_value`` that
    an arm of the type is as far off. ``limited_by`` is the part of ``widened_by`` that keeps the type from moving the tool by
    more than a share of what the rows leave open. ``noise`` is that of the rows, in those of the fit that judged the arm.
    """

    state: Literal["used", "widened", "dropped"]
    widened_by: float | None
    chi_square: float
    compared: int
    p_value: float
    odd: tuple[str, ...] = ()
    limited_by: float = 1.0
    noise: float = 1.0

    def to_document(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "state": self.state,
            "widened_by": self.widened_by,
            "chi_square": self.chi_square,
            "compared": self.compared,
            "p_value": self.p_value,
            "odd": list(self.odd),
            "limited_by": self.limited_by,
        }


HUBER_SIGMAS = 3.0
STILL_MOVING = 3
START_SIGMA = 1e-4  # rad or m: of a sensor at a joint, until the residuals tell


@dataclass(frozen=True)
class Weights:
    """Standard deviations that whiten the residuals: ``points`` m (scalar or (N, 1, 3)), ``turns`` rad, and of ``others``,
    the noise groups of what was measured beside the tool.

    ``rows (N,)`` in [0, 1] say how much each row counts with loss "tukey"; all count fully when None.
    """

    points: float | Floats
    turns: float = 1.0
    rows: Floats | None = None
    others: Mapping[str, float] = field(default_factory=dict)

    def group_sigma(self, group: str) -> float | Floats:
        """Standard deviation of a noise group; where nothing is known yet, about what good sensors have."""
        known: dict[str, float | Floats] = {POINTS: self.points, TURNS: self.turns, **self.others}
        return known.get(group, START_SIGMA)

    def whitening(self, group: str) -> ByDeviation:
        """How a block of that group is whitened."""
        return ByDeviation(self.group_sigma(group))


@dataclass(frozen=True)
class Linearised(Whitened):
    """A problem near some values, with its raw residual."""

    residual: Residual


@dataclass(frozen=True)
class Problem(LeastSquares[Linearised]):
    """What to fit: a model's ``free`` parameters (indices) to a measurement. ``loss`` is "linear", "huber" (per point)
    or "tukey", whose weights of the rows are given.

    ``held (K, F)`` are orthonormal directions, in prior sigmas, along which the parameters stay at ``anchor (F,)``.
    Rows that follow a few numbers each count as these numbers, which say the same in a sixth of the memory, where each row
    weighs alike; with ``whole`` they do not.
    """

    model: RobotModel
    measurement: Measurement
    free: Ints
    weights: Weights
    loss: str = "linear"
    held: Floats | None = None
    anchor: Floats | None = None
    whole: bool = False
    batch: Batch = field(init=False)
    prior: Prior = field(init=False)

    def __post_init__(self) -> None:
        parameters = [self.model.parameters[k] for k in self.free]
        object.__setattr__(self, "batch", self.model.batch(self.measurement.observations))
        object.__setattr__(self, "prior", self.model.prior_of(parameters))

    def with_weights(self, weights: Weights, held: Floats | None, loss: str | None = None) -> Problem:
        """Return the same problem with other weights, held directions and perhaps loss; the batch is shared."""
        other = copy.copy(self)
        object.__setattr__(other, "loss", loss or self.loss)
        object.__setattr__(other, "weights", weights)
        object.__setattr__(other, "held", held)
        return other

    def wholly(self) -> Problem:
        """The same problem in which every row counts by itself; the batch is shared."""
        other = copy.copy(self)
        object.__setattr__(other, "whole", True)
        return other

    def whitened_residuals(self, values: Floats) -> Floats:
        """Whitened residuals (R,) whose squares sum to twice the loss; coordinates of unseen markers are zero."""
        scaled = self._over_sigma(self.measurement.residual(self.model.predict(self.batch, values)))
        return _stack_blocks(scaled, self._roots(scaled, _loss_root))

    def linearise(self, values: Floats, known: Residual | None = None) -> Linearised:
        """Whitened residuals and the whitened Jacobian of the prediction, with the loss they stand for.

        ``known`` is the raw residual there with its Jacobian, where only weights changed since.
        """
        residual = known or linearised_residual(self.model, self.measurement, self.batch, values, self.free)
        scaled = self._over_sigma(residual)
        roots = self._roots(scaled, _weight_root)
        stacked = [self._slope(root, block) for root, block in zip(roots, residual.blocks, strict=True)]
        weighted, exact = self._gradient_and_loss_residuals(scaled, roots, residual)
        whole = stacked[0] if len(stacked) == 1 else np.concatenate(stacked)
        return Linearised(weighted, whole, self.total_loss(values, exact), residual)

    def _slope(self, root: Floats | None, block: Block) -> Floats:
        """Whitened derivative (R, F) of a block, weighed, zero where nothing was measured."""
        spanned, columns = self._spanned_slopes(block), len(self.free)
        if spanned is not None:
            return np.asarray((spanned.short[1] / self.weights.group_sigma(block.group)).reshape(-1, columns))
        return _times(root, self.over_sigma_slope(block), 1).reshape(-1, columns)

    def over_sigma_slope(self, block: Block) -> Floats:
        """Whitened derivative (V, k, w, F) of a block, zero where nothing was measured."""
        assert block.J is not None
        return self.weights.whitening(block.group).columns(block.J, block.r)

    def _spanned_slopes(self, block: Block) -> Spanned | None:
        """How the rows of a block follow a few numbers each, where those may stand for them."""
        if self.whole or self.loss != "linear" or not self.measurement.tool.plain_fits_only:
            return None
        return block.slopes if isinstance(block.slopes, Spanned) else None

    def block_size(self, block: Block) -> int:
        """How many numbers of :meth:`linearise` are of a block."""
        spanned = self._spanned_slopes(block)
        return block.r.size if spanned is None else spanned.short[1][..., 0].size

    @property
    def rows(self) -> float:
        """Number of measured scalars."""
        return float(self.measurement.scalars())

    def required_decrease(self, loss: float) -> float:
        """What a step must promise where a kind of measurement says so."""
        return self.measurement.relative_tolerance * (1.0 + loss)

    def evaluate(self, values: Floats) -> Linearised:
        """Linearise there."""
        return self.linearise(values)

    def current(self, values: Floats) -> Floats:
        """Values of the free parameters."""
        return values[self.free]

    def apply_change(self, values: Floats, change: Floats) -> Floats:
        """Change the free parameters."""
        out = values.copy()
        out[self.free] += change
        return out

    def beyond(self, here: Linearised, values: Floats, step: Floats) -> Linearised:
        """What is at ``values (P,)``, a small ``step (F,)`` in prior sigmas from ``here``; the Jacobian stays."""
        residual = Residual(tuple(block.beyond(step * self.prior_sigma) for block in here.residual.blocks))
        scaled = self._over_sigma(residual)
        r, exact = self._gradient_and_loss_residuals(scaled, self._roots(scaled, _weight_root), residual)
        return Linearised(r, here.J, self.total_loss(values, exact), residual)

    def bend(self, values: Floats, here: Linearised, step: Floats) -> Floats:
        """How the prediction bends along a step; the numbers that rows follow are those ``here``."""
        if all(self._spanned_slopes(block) is None for block in here.residual.blocks):
            return super().bend(values, here, step)
        prediction = self.model.predict(self.batch, self.apply_step(values, BEND * step))
        scaled = self._over_sigma(self.measurement.residual(prediction))
        return self._bent(here, self._compress_blocks(scaled, here.residual), step)

    def by_row(self, here: Linearised) -> tuple[Floats, Floats]:
        """Jacobian (N, R, F) in prior sigmas and residuals (N, R), whitened, of all that each row measured."""
        rows = len(self.measurement.observations)
        ends = np.cumsum([self.block_size(block) for block in here.residual.blocks])[:-1]
        J, r = np.split(here.J * self.prior_sigma, ends), np.split(here.r, ends)
        A = [part.reshape(rows, -1, part.shape[1]) for part in J]
        return np.concatenate(A, axis=1), np.concatenate([part.reshape(rows, -1) for part in r], axis=1)

    def _gradient_and_loss_residuals(
        self, scaled: list[Floats], roots: list[Floats | None], residual: Residual
    ) -> tuple[Floats, Floats]:
        """Residuals that have the slope of the loss, and residuals whose squares are twice the loss."""
        weighted = _stack_blocks(scaled, roots)
        if roots[0] is None:
            return self._compress_blocks(scaled, residual, weighted), weighted
        return weighted, _stack_blocks(scaled, self._roots(scaled, _loss_root))

    def _compress_blocks(self, scaled: list[Floats], at: Residual, stacked: Floats | None = None) -> Floats:
        """Whitened blocks in a row, those whose rows follow a few numbers ``at`` some values as these numbers."""
        spanned = [self._spanned_slopes(block) for block in at.blocks]
        if all(one is None for one in spanned):
            return _stack_blocks(scaled, [None] * len(scaled)) if stacked is None else stacked
        short = [r if one is None else one.of_short(r) for one, r in zip(spanned, scaled, strict=True)]
        return _stack_blocks(short, [None] * len(short))

    def _over_sigma(self, residual: Residual) -> list[Floats]:
        """Whitened blocks (V, k, w), zero where nothing was measured."""
        return [self.weights.whitening(block.group).residual(block.r) for block in residual.blocks]

    def roots(self, residual: Residual) -> list[Floats | None]:
        """Roots of the weights (V, k, 1) that the loss gives what is left in each block, None where all are one."""
        return self._roots(self._over_sigma(residual), _weight_root)

    def _roots(self, scaled: list[Floats], root: Callable[[Floats], Floats]) -> list[Floats | None]:
        """Roots of the weights (V, k, 1) of each block, None where all are one."""
        if self.loss == "tukey" and self.weights.rows is not None:
            of_rows = np.sqrt(self.weights.rows)[:, None, None]
            return [of_rows for _ in scaled]
        if self.loss != "huber":
            return [None for _ in scaled]
        return [root(np.linalg.norm(block, axis=2, keepdims=True)) for block in scaled]


def _stack_blocks(scaled: list[Floats], roots: list[Floats | None]) -> Floats:
    """All blocks, weighed, in a row (R,)."""
    parts = [_times(root, block).reshape(-1) for root, block in zip(roots, scaled, strict=True)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


@dataclass(frozen=True)
class Fit:
    """A converged fit. ``J (R, F)`` is whitened; ``covariance (F, F)`` includes the priors.

    ``freedom`` is that of the covariance's scale, None where the rows are taken as independent.
    """

    problem: Problem
    values: Floats
    covariance: Floats
    J: Floats
    cost: float
    effective: float
    iterations: int
    residual: Residual
    freedom: float | None = None
    report: Mapping[str, Any] = field(default_factory=dict)  # what the method tells besides, JSON-able
    prior_use: PriorUse | None = None  # how far the arm's type was believed

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.problem.model.names[k] for k in self.problem.free)

    @property
    def sigma(self) -> Floats:
        """Posterior standard deviations (F,) of the free parameters."""
        return np.sqrt(np.diag(self.covariance))

    def calibration(self, base: Floats | None = None, tool: Floats | None = None) -> Calibration:
        """What was fitted, increments absorbed in the poses of base and tool; ``base`` and ``tool`` are the wanted frames."""
        problem = self.problem
        model, values = problem.model.absorb_frame_increments(self.values)
        return Calibration(model.hanging_as(values), values, problem.measurement.marker_points, base, tool)


def solve(
    problem: Problem,
    start: Floats,
    progress: StepProgress | None = None,
    known: Residual | None = None,
    enough: float = 0.0,
) -> Fit:
    """Fit the free parameters from ``start (P,)``, where ``known`` is the raw residual if it was computed before.

    ``enough`` ends the fit early, once a step takes less than this share off the loss.

    Raises:
        NotConvergedError: no minimum within the iteration limit, or numbers that are not finite.

    """
    found = minimise(problem, start, problem.linearise(start, known), progress, enough)
    if not found.converged:
        raise _endless(problem, found)
    return build_fit(problem, found.values, found.point, found.iterations)


def _endless(problem: Problem, found: Minimum[Linearised]) -> NotConvergedError:
    """Say what still moved: held at their values, these let the others come to rest."""
    order = np.argsort(-np.abs(found.step), kind="stable")[:STILL_MOVING]
    names = [problem.model.names[problem.free[k]] for k in order]
    return NotConvergedError(
        f"No minimum after {found.iterations} iterations: {', '.join(names)} still move together, since these poses "
        f"hardly tell them apart. Fix them (--fix {','.join(names)}), or measure poses that differ in more joints.",
        iterations=found.iterations,
        moving=names,
    )


def _times(root: Floats | None, array: Floats, more_axes: int = 0) -> Floats:
    if root is None:
        return array
    return np.asarray(root.reshape(root.shape + (1,) * more_axes) * array)


def _loss_root(size: Floats) -> Floats:
    """Root of 2 rho(s) / s² for Huber's rho: residuals scaled by it square to twice the loss."""
    k = HUBER_SIGMAS
    safe = np.maximum(size, k)
    return np.asarray(np.where(size <= k, 1.0, np.sqrt(2.0 * k * safe - k * k) / safe))


def _weight_root(size: Floats) -> Floats:
    """Root of rho'(s) / s: residuals and Jacobian scaled by it have the slope of the loss."""
    return np.asarray(np.sqrt(HUBER_SIGMAS / np.maximum(size, HUBER_SIGMAS)))


def build_fit(problem: Problem, values: Floats, here: Linearised, iterations: int = 0) -> Fit:
    """Fit that ends at ``values (P,)``, with the covariance of the problem linearised there."""
    H, _ = problem.normal_equations(values, here)
    inverse = np.linalg.inv(H)
    resting = inverse if problem.prior.precision is None else inverse @ problem.prior.precision
    scale = problem.prior_sigma
    return Fit(
        problem=problem,
        values=values,
        covariance=inverse * np.outer(scale, scale),
        J=here.J,
        cost=here.loss,
        effective=float(len(H) - np.trace(resting)),
        iterations=iterations,
        residual=here.residual,
    )


def freedom_by_group(fit: Fit) -> dict[str, float]:
    """Numbers of each noise group less what the parameters took of them, where several kinds were measured (Förstner 1979).

    A fit follows ten points of a tracker beside thousands of corners far more closely than these. Corrected as all of them
    together, their noise came out five times too small.
    """
    measurement = fit.problem.measurement
    if len(measurement.kinds) == 1:
        return {}
    numbers: dict[str, float] = {}
    for block in fit.residual.blocks:
        seen = np.count_nonzero(~np.isnan(block.r)) / measurement.group_redundancy(block.group)
        numbers[block.group] = numbers.get(block.group, 0.0) + seen
    taken = taken_by_group(fit)
    return {group: float(max(count - taken[group], 1.0)) for group, count in numbers.items()}


def taken_by_group(fit: Fit) -> dict[str, float]:
    """How many numbers of each noise group the parameters took."""
    start, taken = 0, dict[str, float]()
    for block in fit.residual.blocks:
        J = fit.J[start : start + fit.problem.block_size(block)]
        start += len(J)
        taken[block.group] = taken.get(block.group, 0.0) + float(np.sum((J.T @ J) * fit.covariance))
    return taken
