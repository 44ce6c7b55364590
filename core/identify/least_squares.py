"""Weighted nonlinear least squares with Gaussian priors: Levenberg and Marquardt on the model's exact Jacobian.

Parameters are scaled by their prior sigma, so the prior adds the identity to the normal equations: they stay solvable
whatever the poses do not see. (Without priors a rank-deficient fit wandered to 1e13; with them it took 4 evaluations.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from core.effects import Batch
from core.errors import NotConvergedError
from core.measurement import Measurement
from core.model import RobotModel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Progress = Callable[[int, float], None]

HUBER_SIGMAS = 3.0
MAX_ITERATIONS = 60
HOLD = 1e8  # stiffness of a held direction against a prior of 1
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

    def whitened(self, values: Floats) -> Floats:
        """Whitened residuals (R,); coordinates of unseen markers are zero."""
        residual = self.measurement.residual(self.model.predict(self.batch, values))
        points = np.nan_to_num(residual.points / self.weights.points)
        turns = None if residual.turns is None else residual.turns / self.weights.turns
        return self._robust(points, turns)[0]

    def linearised(self, values: Floats) -> tuple[Floats, Floats]:
        """Whitened residuals (R,) and the whitened Jacobian of the prediction (R, F)."""
        prediction, J = self.model.jacobian(self.batch, values, self.free)
        residual = self.measurement.residual(prediction, J)
        assert residual.d_points is not None
        scale = self.weights.points if isinstance(self.weights.points, float) else self.weights.points[..., None]
        seen = ~np.isnan(residual.points)
        points = np.nan_to_num(residual.points / self.weights.points)
        d_points = np.where(seen[..., None], residual.d_points / scale, 0.0)
        turns = d_turns = None
        if residual.turns is not None and residual.d_turns is not None:
            turns, d_turns = residual.turns / self.weights.turns, residual.d_turns / self.weights.turns
        r, root_points, root_turns = self._robust(points, turns)
        columns = len(self.free)
        stacked = [(root_points[..., None] * d_points).reshape(-1, columns)]
        if d_turns is not None:
            stacked.append((root_turns[..., None] * d_turns).reshape(-1, columns))
        return r, np.concatenate(stacked)

    def _robust(self, points: Floats, turns: Floats | None) -> tuple[Floats, Floats, Floats]:
        """Stack residuals, each scaled by the root of its Huber weight; also those roots."""
        root_points = np.ones((*points.shape[:2], 1))
        root_turns = np.ones((len(points), 1))
        if self.loss == "huber":
            root_points = _huber_root(np.linalg.norm(points, axis=2, keepdims=True))
            if turns is not None:
                root_turns = _huber_root(np.linalg.norm(turns, axis=1, keepdims=True))
        parts = [(root_points * points).reshape(-1)]
        if turns is not None:
            parts.append((root_turns * turns).reshape(-1))
        return np.concatenate(parts), root_points, root_turns


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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.problem.model.names[k] for k in self.problem.free)

    @property
    def sigma(self) -> Floats:
        """Posterior standard deviations (F,) of the free parameters."""
        return np.sqrt(np.diag(self.covariance))


def solve(problem: Problem, start: Floats, progress: Progress | None = None) -> Fit:
    """Fit the free parameters from ``start (P,)``.

    Raises:
        NotConvergedError: no minimum within the iteration limit, or numbers that are not finite.

    """
    values = start.copy()
    damping = 1e-6
    r, J = problem.linearised(values)
    cost = _cost(problem, values, r)
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not np.isfinite(cost):
            raise NotConvergedError("The residuals are not finite: check the observations for impossible values.")
        H, g = _holding(problem, values, *_normal_equations(problem, values, r, J))
        step, drop, damping, trial = _damped_step(problem, values, H, g, cost, damping)
        if progress is not None:
            progress(iteration, cost)
        if trial is not None:
            values = trial
            r, J = problem.linearised(values)
            cost = _cost(problem, values, r)
        if trial is None or np.max(np.abs(step), initial=0.0) < STEP_TOLERANCE or drop < 1e-12 * (1.0 + cost):
            return _finish(problem, values, r, J, iteration)
    raise NotConvergedError(
        f"No minimum after {MAX_ITERATIONS} iterations: fix some parameters, or start from a better version.",
        iterations=MAX_ITERATIONS,
    )


def _damped_step(
    problem: Problem, values: Floats, H: Floats, g: Floats, cost: float, damping: float
) -> tuple[Floats, float, float, Floats | None]:
    """Raise the damping until a step lowers the cost. No such step (None) means a minimum to rounding."""
    step = np.zeros(len(g))
    for _ in range(25):
        damped = H + damping * np.diag(np.diag(H))
        step = scipy.linalg.solve(damped, g, assume_a="pos")
        trial = values.copy()
        trial[problem.free] += step * problem.prior_sigma
        lower = _cost(problem, trial, problem.whitened(trial))
        if lower < cost:
            return step, cost - lower, damping * 0.1, trial
        if np.max(np.abs(step), initial=0.0) < STEP_TOLERANCE:
            break
        damping = max(damping * 10.0, 1e-9)
    return step, 0.0, damping, None


def _normal_equations(problem: Problem, values: Floats, r: Floats, J: Floats) -> tuple[Floats, Floats]:
    scaled = J * problem.prior_sigma
    H = scaled.T @ scaled
    H[np.diag_indices_from(H)] += 1.0
    return H, scaled.T @ r - _from_prior(problem, values)


def _from_prior(problem: Problem, values: Floats) -> Floats:
    return np.asarray((values[problem.free] - problem.prior_mean) / problem.prior_sigma)


def _cost(problem: Problem, values: Floats, r: Floats) -> float:
    """Half the sum of squares, Huber's where asked, with the prior's."""
    prior = float(np.sum(_from_prior(problem, values) ** 2))
    return 0.5 * (float(r @ r) + prior + HOLD * float(np.sum(_strayed(problem, values) ** 2)))


def _strayed(problem: Problem, values: Floats) -> Floats:
    """How far the held directions have moved, in prior sigmas."""
    if problem.held is None or problem.anchor is None:
        return np.zeros(0)
    return np.asarray(problem.held @ ((values[problem.free] - problem.anchor) / problem.prior_sigma))


def _holding(problem: Problem, values: Floats, H: Floats, g: Floats) -> tuple[Floats, Floats]:
    if problem.held is None:
        return H, g
    return H + HOLD * problem.held.T @ problem.held, g - HOLD * problem.held.T @ _strayed(problem, values)


def _huber_root(size: Floats) -> Floats:
    """Root of rho(s)/s² for Huber's rho, so that scaled residuals square to twice the robust cost."""
    k = HUBER_SIGMAS
    safe = np.maximum(size, k)
    return np.asarray(np.where(size <= k, 1.0, np.sqrt(2.0 * k * safe - k * k) / safe))


def _finish(problem: Problem, values: Floats, r: Floats, J: Floats, iterations: int) -> Fit:
    H, _ = _normal_equations(problem, values, r, J)
    inverse = scipy.linalg.inv(H)
    scale = problem.prior_sigma
    return Fit(
        problem=problem,
        values=values,
        covariance=inverse * np.outer(scale, scale),
        J=J,
        cost=_cost(problem, values, r),
        effective=float(len(H) - np.trace(inverse)),
        iterations=iterations,
    )
