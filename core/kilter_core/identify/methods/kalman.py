"""Recursive identification: pose after pose, from what a version knows to what the next version knows.

An extended Kalman filter whose state is the free parameters, at rest between poses. With the start's covariance a
campaign can grow for weeks without the old measurements: the covariance that comes in holds all they taught.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import NotConvergedError, OptionError
from kilter_core.identify.estimate import estimate_weights, has_sigma_settled, prepare_problem, unobservable_directions
from kilter_core.identify.fit.least_squares import Fit, Problem, build_fit
from kilter_core.identify.measured_rows import repeat_sigma
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.types import Floats, Progress

PASSES = 12  # over the same rows from the same prior, each linearised where the last ended
SETTLED = 1e-3  # largest move of a pass, in posterior sigmas


@dataclass(frozen=True)
class Prior:
    """What is known before: a covariance ``matrix (K, K)``, SI, of the parameters ``names`` about the start's values."""

    names: tuple[str, ...]
    matrix: Floats

    def over(self, problem: Problem, names: tuple[str, ...]) -> Floats:
        """Covariance (F, F) of the problem's free parameters in prior sigmas; names not known before keep their prior.

        Raises:
            OptionError: a matrix of another size than its names.

        """
        if self.matrix.shape != (len(self.names),) * 2:
            raise OptionError(
                f"The start's covariance is {self.matrix.shape} for {len(self.names)} names: identify the start anew.",
                option="start",
            )
        out = np.eye(len(names))
        known = [c for c, name in enumerate(names) if name in self.names]
        own = [self.names.index(names[c]) for c in known]
        scale = problem.prior_sigma[known]
        out[np.ix_(known, known)] = self.matrix[np.ix_(own, own)] / np.outer(scale, scale)
        return out


def kalman(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None = None,
    prior: Prior | None = None,
) -> Fit:
    """Filter the rows in their order. With a ``prior`` the start is a state to continue, else base and tool are registered.

    Raises:
        TooFewPosesError: without a prior, fewer measured numbers than free parameters.

    """
    problem, values = prepare_problem(start, measurement, options, registered=prior is not None)
    names = tuple(problem.model.names[k] for k in problem.free)
    P0 = np.eye(len(names)) if prior is None else prior.over(problem, names)
    x0 = problem.prior_mean if prior is None else values[problem.free]
    repeats = repeat_sigma(measurement.observations)
    if options.noise_mm is None and repeats and measurement.observations.sigma is None:
        problem = problem.with_weights(replace(problem.weights, points=repeats), None)
    for step in range(PASSES):
        if progress is not None:
            progress(step / PASSES, f"pass {step + 1}")
        before = values[problem.free]
        values[problem.free], P, innovation = run_kalman_filter(problem, values, x0, P0)
        if not np.isfinite(values).all():
            raise NotConvergedError("The filter lost its way: begin with least_squares, or a better start.")
        fit = _fit_from_state(problem, values, P, P0, innovation, fresh=prior is None)
        wanted = estimate_weights(fit, options)
        unobservable = unobservable_directions(fit) if prior is None and step == 1 else np.zeros((0, len(names)))
        moved = float(np.max(np.abs(values[problem.free] - before) / fit.sigma, initial=0.0))
        settled = has_sigma_settled(float(np.mean(wanted.points)), float(np.mean(problem.weights.points)))
        if step > 0 and moved < SETTLED and settled and len(unobservable) == 0:
            break
        P0 = P0 - unobservable.T @ unobservable  # known to stay where they are
        problem = problem.with_weights(wanted, None)
    return fit


def run_kalman_filter(problem: Problem, values: Floats, x0: Floats, P0: Floats) -> tuple[Floats, Floats, float]:
    """State (F,) SI and covariance (F, F) in prior sigmas after all rows, from ``x0`` and ``P0``; mean innovation.

    The rows are linearised together at ``values (P,)`` and enter one after the other, so a pass ends where the batch
    solution of the same linearised rows ends. The mean square of the innovations is one when noise and P are right.
    """
    J, r = problem.by_row(problem.linearise(values))
    scale = problem.prior_sigma
    here, x, P = values[problem.free] / scale, x0 / scale, P0
    total, count = 0.0, 0
    for Jp, rp in zip(J, r, strict=True):
        left = rp - Jp @ (x - here)
        S = np.eye(len(Jp)) + Jp @ P @ Jp.T
        gain = np.linalg.solve(S, Jp @ P).T
        seen = int(np.count_nonzero(np.any(Jp != 0.0, axis=1)))
        total, count = total + float(left @ np.linalg.solve(S, left)), count + seen
        x = x + gain @ left
        kept = np.eye(len(x)) - gain @ Jp
        P = kept @ P @ kept.T + gain @ gain.T  # Joseph's form keeps P sound
    return x * scale, P, total / max(count, 1)


def _fit_from_state(problem: Problem, values: Floats, P: Floats, P0: Floats, innovation: float, fresh: bool) -> Fit:
    """The fit; its Jacobian also carries what was known before, so that it is not reported as unseen.

    Only a ``fresh`` filter holds directions; one that continues may know some of them that well.
    """
    rows = len(problem.measurement.observations)
    fit = build_fit(problem, values.copy(), problem.linearise(values), rows)
    size, turn = np.linalg.eigh(P0)
    before = np.sqrt(np.maximum(1.0 / np.maximum(size, 1e-12) - 1.0, 0.0))
    held = (size < 1e-9) & fresh  # unobservable directions were held, not learned
    known = (turn * np.where(held, 0.0, before)).T / problem.prior_sigma
    known = known[np.linalg.norm(known * problem.prior_sigma, axis=1) > 1e-6]
    scale = np.outer(problem.prior_sigma, problem.prior_sigma)
    report = {"rows": rows, "continued": bool(len(known)), "mean_square_innovation": innovation}
    return replace(
        fit,
        J=np.concatenate([fit.J, known]),
        covariance=(P + turn[:, held] @ turn[:, held].T) * scale,
        effective=float(len(P) - np.trace(np.linalg.solve(P0 + 1e-12 * np.eye(len(P0)), P))),
        report=report,
    )
