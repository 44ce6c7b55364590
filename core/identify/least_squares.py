"""Weighted nonlinear least squares with Gaussian priors: Levenberg and Marquardt on the model's exact Jacobian.

Parameters are scaled by their prior sigma, so the prior adds the identity to the normal equations: they stay solvable
whatever the poses do not see. (Without priors a rank-deficient fit wandered to 1e13; with them it took 4 evaluations.)
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.effects import Batch
from core.errors import NotConvergedError
from core.measurement import Measurement, Residual
from core.model import RobotModel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[int, float], None]

HUBER_SIGMAS = 3.0
MAX_ITERATIONS = 60
HOLD = 1e8  # stiffness of a held direction against a prior of 1
ROUNDING = 1e-13  # share of the loss that a step must promise to be worth taking
LAST = 1e-9  # share below which the step is taken and the model not asked again: it is linear that near
STEP_TOLERANCE = 1e-9  # largest step, in prior sigmas and relative to the posterior, that counts as converged


@dataclass(frozen=True)
class Weights:
    """Standard deviations that whiten the residuals: ``points`` m (scalar or (N, 1, 3)), ``turns`` rad."""

    points: float | Floats
    turns: float = 1.0


@dataclass(frozen=True)
class Problem:
    """What to fit: a model's ``free`` parameters (indices) to a measurement. ``loss`` is "linear" or "huber" (per point).

    ``held (K, F)`` are orthonormal directions, in prior sigmas, along which the parameters stay at ``anchor (F,)``.
    """

    model: RobotModel
    measurement: Measurement
    free: Ints
    weights: Weights
    loss: str = "linear"
    held: Floats | None = None
    anchor: Floats | None = None
    batch: Batch = field(init=False)
    prior_mean: Floats = field(init=False)
    prior_sigma: Floats = field(init=False)

    def __post_init__(self) -> None:
        parameters = [self.model.parameters[k] for k in self.free]
        object.__setattr__(self, "batch", self.model.batch(self.measurement.observations))
        object.__setattr__(self, "prior_mean", np.array([p.value for p in parameters]))
        object.__setattr__(self, "prior_sigma", np.array([p.prior_sigma for p in parameters]))

    def reweighted(self, weights: Weights, held: Floats | None) -> Problem:
        """Return the same problem with other weights and held directions; the batch is shared."""
        other = copy.copy(self)
        object.__setattr__(other, "weights", weights)
        object.__setattr__(other, "held", held)
        return other

    def whitened(self, values: Floats) -> Floats:
        """Whitened residuals (R,) whose squares sum to twice the loss; coordinates of unseen markers are zero."""
        residual = self.measurement.residual(self.model.predict(self.batch, values))
        points, turns = self._over_sigma(residual)
        return self._stacked(points, turns, *self._roots(points, turns, _loss_root))

    def linearised(self, values: Floats, known: Residual | None = None) -> Linearised:
        """Whitened residuals and the whitened Jacobian of the prediction, with the loss they stand for.

        ``known`` is the raw residual there with its Jacobian, where only weights changed since.
        """
        residual = known or self._raw(values)
        assert residual.d_points is not None
        points, turns = self._over_sigma(residual)
        scale = self.weights.points if isinstance(self.weights.points, float) else self.weights.points[..., None]
        d_points = residual.d_points / scale
        if self.measurement.marker_points is not None:
            d_points[np.isnan(residual.points)] = 0.0
        root_points, root_turns = self._roots(points, turns, _weight_root)
        columns = len(self.free)
        stacked = [_times(root_points, d_points, 1).reshape(-1, columns)]
        if residual.d_turns is not None:
            stacked.append(_times(root_turns, residual.d_turns / self.weights.turns, 1).reshape(-1, columns))
        weighted, exact = self._both(points, turns, root_points, root_turns)
        whole = stacked[0] if len(stacked) == 1 else np.concatenate(stacked)
        return Linearised(weighted, whole, self.loss_at(values, exact), residual)

    def _raw(self, values: Floats) -> Residual:
        turns = self.measurement.sees_orientation
        return self.measurement.residual(*self.model.jacobian(self.batch, values, self.free, turns))

    def beyond(self, here: Linearised, values: Floats, step: Floats) -> Linearised:
        """What is at ``values (P,)``, a small ``step (F,)`` from where the problem was linearised; the Jacobian stays."""
        raw = here.residual
        assert raw.d_points is not None
        turned = raw.turns if raw.turns is None or raw.d_turns is None else raw.turns - raw.d_turns @ step
        residual = Residual(raw.points - raw.d_points @ step, raw.d_points, turned, raw.d_turns)
        points, turns = self._over_sigma(residual)
        r, exact = self._both(points, turns, *self._roots(points, turns, _weight_root))
        return Linearised(r, here.J, self.loss_at(values, exact), residual)

    def _both(
        self, points: Floats, turns: Floats | None, root_points: Floats | None, root_turns: Floats | None
    ) -> tuple[Floats, Floats]:
        """Residuals that have the slope of the loss, and residuals whose squares are twice the loss."""
        weighted = self._stacked(points, turns, root_points, root_turns)
        if root_points is None:
            return weighted, weighted
        return weighted, self._stacked(points, turns, *self._roots(points, turns, _loss_root))

    def loss_at(self, values: Floats, r: Floats) -> float:
        """Half the sum of squares of ``r``, of the prior and of what strayed along held directions."""
        prior = (values[self.free] - self.prior_mean) / self.prior_sigma
        with np.errstate(over="ignore"):  # a residual beyond all bounds is said in words by the solver
            return 0.5 * (float(r @ r) + float(prior @ prior) + HOLD * float(np.sum(_strayed(self, values) ** 2)))

    def _over_sigma(self, residual: Residual) -> tuple[Floats, Floats | None]:
        points = residual.points / self.weights.points
        if self.measurement.marker_points is not None:
            points[np.isnan(points)] = 0.0
        return points, None if residual.turns is None else residual.turns / self.weights.turns

    def _roots(
        self, points: Floats, turns: Floats | None, root: Callable[[Floats], Floats]
    ) -> tuple[Floats | None, Floats | None]:
        """Roots of the weights (N, m, 1) of points and (N, 1) of turns, None where all are one."""
        if self.loss != "huber":
            return None, None
        of_points = root(np.linalg.norm(points, axis=2, keepdims=True))
        return of_points, None if turns is None else root(np.linalg.norm(turns, axis=1, keepdims=True))

    @staticmethod
    def _stacked(points: Floats, turns: Floats | None, root_points: Floats | None, root_turns: Floats | None) -> Floats:
        whole = _times(root_points, points).reshape(-1)
        return whole if turns is None else np.concatenate([whole, _times(root_turns, turns).reshape(-1)])


@dataclass(frozen=True)
class Linearised:
    """A problem near some values: ``r (R,)`` and ``J (R, F)``, Jᵀr the downhill slope of the ``loss``; the raw residual."""

    r: Floats
    J: Floats
    loss: float
    residual: Residual


@dataclass(frozen=True)
class Fit:
    """A converged fit. ``J (R, F)`` is whitened; ``covariance (F, F)`` includes the priors."""

    problem: Problem
    values: Floats
    covariance: Floats
    J: Floats
    cost: float
    effective: float
    iterations: int
    residual: Residual
    report: Mapping[str, Any] = field(default_factory=dict)  # what the method tells besides, JSON-able

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.problem.model.names[k] for k in self.problem.free)

    @property
    def sigma(self) -> Floats:
        """Posterior standard deviations (F,) of the free parameters."""
        return np.sqrt(np.diag(self.covariance))


def solve(problem: Problem, start: Floats, progress: Progress | None = None, known: Residual | None = None) -> Fit:
    """Fit the free parameters from ``start (P,)``, where ``known`` is the raw residual if it was computed before.

    Raises:
        NotConvergedError: no minimum within the iteration limit, or numbers that are not finite.

    """
    values, damping = start.copy(), 1e-6
    here = problem.linearised(values, known)
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not np.isfinite(here.loss):
            raise NotConvergedError("The residuals are not finite: check the observations for impossible values.")
        H, g = _holding(problem, values, *normal_equations(problem, values, here))
        taken = _damped_step(problem, values, H, g, here, damping)
        if progress is not None:
            progress(iteration, here.loss)
        if taken is None:
            return fit_at(problem, values, here, iteration)
        last, damping, values, here = taken
        if last:
            return fit_at(problem, values, here, iteration)
    raise NotConvergedError(
        f"No minimum after {MAX_ITERATIONS} iterations: fix some parameters, or start from a better version.",
        iterations=MAX_ITERATIONS,
    )


def _damped_step(
    problem: Problem, values: Floats, H: Floats, g: Floats, here: Linearised, damping: float
) -> tuple[bool, float, Floats, Linearised] | None:
    """Raise the damping until a step lowers the loss: whether it was the last, the next damping, the values, what is there.

    None where no step does: a minimum to rounding.
    """
    diagonal, loss = np.diag(H), here.loss
    for _ in range(25):
        damped = H.copy()
        damped.flat[:: len(H) + 1] += damping * diagonal
        step = np.asarray(np.linalg.solve(damped, g), dtype=np.float64)
        promised = float(step @ g)
        worth = max(ROUNDING, problem.measurement.settled) * (1.0 + loss)
        if promised < worth or np.max(np.abs(step), initial=0.0) < STEP_TOLERANCE:
            return None
        trial = values.copy()
        trial[problem.free] += step * problem.prior_sigma
        if promised < LAST * (1.0 + loss) and damping < 1e-3:
            return True, damping, trial, problem.beyond(here, trial, step * problem.prior_sigma)
        # Nearly every step is good, so its Jacobian is taken at once instead of after its loss.
        there = problem.linearised(trial)
        if there.loss < loss:
            return False, damping * 0.1, trial, there
        damping = max(damping * 10.0, 1e-9)
    return None


def normal_equations(problem: Problem, values: Floats, here: Linearised) -> tuple[Floats, Floats]:
    """Matrix (F, F) and slope (F,) in prior sigmas, the priors included."""
    scale = problem.prior_sigma
    H = (here.J.T @ here.J) * np.outer(scale, scale)
    H.flat[:: len(H) + 1] += 1.0
    return H, scale * (here.J.T @ here.r) - (values[problem.free] - problem.prior_mean) / problem.prior_sigma


def _strayed(problem: Problem, values: Floats) -> Floats:
    """How far the held directions have moved, in prior sigmas."""
    if problem.held is None or problem.anchor is None:
        return np.zeros(0)
    return np.asarray(problem.held @ ((values[problem.free] - problem.anchor) / problem.prior_sigma))


def _holding(problem: Problem, values: Floats, H: Floats, g: Floats) -> tuple[Floats, Floats]:
    if problem.held is None:
        return H, g
    return H + HOLD * problem.held.T @ problem.held, g - HOLD * problem.held.T @ _strayed(problem, values)


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


def fit_at(problem: Problem, values: Floats, here: Linearised, iterations: int) -> Fit:
    """Fit that ends at ``values (P,)``, with the covariance of the problem linearised there."""
    H, _ = normal_equations(problem, values, here)
    inverse = np.linalg.inv(H)
    scale = problem.prior_sigma
    return Fit(
        problem=problem,
        values=values,
        covariance=inverse * np.outer(scale, scale),
        J=here.J,
        cost=here.loss,
        effective=float(len(H) - np.trace(inverse)),
        iterations=iterations,
        residual=here.residual,
    )
