"""Intervals that do not trust the covariance: bootstrap over poses, and profiles of the likelihood."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import NotConvergedError
from kilter_core.identify.fit.least_squares import Fit, solve
from kilter_core.types import QUANTILE, Bools, Each, Floats, Ints, Progress, run_sequentially

CONFIDENCE = 0.95
RESAMPLES = 1000
TRIALS = 4  # fits per end of a profile
PIN = 0.01  # of HOLD's root: the pin is ten thousand times stiffer than the data
CLOSE = 0.01  # of the quantile, at which an end counts as found


@dataclass(frozen=True)
class Intervals:
    """Moves ``lower`` and ``upper (F,)`` SI from the fitted values that bound 95 % of what each parameter may be.

    ``stands_in (F,)`` marks parameters whose profile has no minimum to follow: 1.96 sigma replace it.
    """

    kind: str
    lower: Floats
    upper: Floats
    stands_in: Bools

    def widen_by_factor(self, factor: Floats) -> Intervals:
        """The intervals of each parameter times a factor (F,)."""
        return replace(self, lower=self.lower * factor, upper=self.upper * factor)


def bootstrap(fit: Fit, seed: int, progress: Progress, resamples: int = RESAMPLES) -> Intervals:
    """Resample whole poses and refit from the fitted values, each refit one Gauss-Newton step.

    The step is exact where the model is linear over a few sigmas, as calibrated arms are; weights of a robust loss stay
    those of the fit.
    """
    problem = fit.problem
    o = problem.measurement.observations
    H, g = _by_pose(fit, o.pose_groups())
    rng, scale = np.random.default_rng(seed), problem.prior_sigma
    known = problem.prior_information()
    prior = -known @ ((fit.values[problem.free] - problem.prior_mean) / scale)
    rest = known * (1.0 + 1e-12)
    moves = np.empty((resamples, len(scale)))
    for b in range(resamples):
        count = rng.multinomial(len(H), np.full(len(H), 1.0 / len(H))).astype(np.float64)
        moves[b] = np.linalg.solve(np.tensordot(count, H, 1) + rest, count @ g + prior) * scale
        if b % 50 == 0:
            progress(b / resamples, f"resample {b} of {resamples}")
    low, high = np.percentile(moves, [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)], axis=0)
    return Intervals("bootstrap", low, high, np.zeros(len(low), dtype=bool))


def profile(fit: Fit, progress: Progress, each: Each = run_sequentially) -> Intervals:
    """Where the loss, minimised over all other parameters, has risen by what 95 % allow (1.92), on either side.

    Each parameter takes up to ``2 * TRIALS`` fits and knows nothing of the others: ``each`` computes them.
    """
    tasks = [(fit, c) for c in range(len(fit.names))]
    found = each(profile_ends, tasks, lambda fraction, stage: progress(fraction, f"profile {stage}"))
    lower, upper, stands_in = zip(*found, strict=True)
    return Intervals("profile", np.array(lower), np.array(upper), np.array(stands_in, dtype=bool))


def profile_ends(task: tuple[Fit, int], progress: Progress) -> tuple[float, float, bool]:
    """Lower and upper end of one parameter's profile, and whether 1.96 sigma stand in for an end that is not there."""
    fit, c = task
    sigma, ends, stands_in = float(fit.sigma[c]), [], False
    for side, sign in enumerate((-1.0, 1.0)):
        progress(0.5 * side, fit.names[c])
        end = _find_profile_end(fit, c, sign * sigma)
        stands_in |= end is None
        ends.append(sign * QUANTILE * sigma if end is None else end)
    return ends[0], ends[1], stands_in


def _by_pose(fit: Fit, groups: Ints) -> tuple[Floats, Floats]:
    """Normal matrices (G, F, F) and slopes (G, F) of each pose, in prior sigmas."""
    here = fit.problem.linearise(fit.values)
    scaled = here.J * fit.problem.prior_sigma
    rows = len(groups)
    owner = np.concatenate([np.repeat(groups, block.r.size // rows) for block in here.residual.blocks])
    count = int(groups.max()) + 1
    H, g = np.zeros((count, scaled.shape[1], scaled.shape[1])), np.zeros((count, scaled.shape[1]))
    for pose in range(count):
        mine = scaled[owner == pose]
        H[pose], g[pose] = mine.T @ mine, mine.T @ here.r[owner == pose]
    return H, g


def _find_profile_end(fit: Fit, c: int, sigma: float) -> float | None:
    """Move of parameter ``c`` at which the root of twice the loss reaches the quantile; None if it never does."""
    try:
        return profile_end(lambda move: _root(fit, c, move), QUANTILE * sigma, QUANTILE, TRIALS)
    except NotConvergedError:
        return None


def profile_end(
    root: Callable[[float], float], move: float, target: float, trials: int, close: float = CLOSE
) -> float | None:
    """Move at which the ``root`` of what a profile rises by reaches its ``target``, from the linear guess ``move``.

    By secants, at most ``trials`` of them, each a fit, until the root is as ``close`` to its target as that share; None
    where the profile does not rise.
    """
    for _ in range(trials):
        risen = root(move)
        if not risen > 0.0:
            return None
        if abs(risen / target - 1.0) < close:
            break
        move *= min(max(target / risen, 0.5), 2.0)
    return move


def _root(fit: Fit, c: int, move: float) -> float:
    """Root of twice the rise of the loss when parameter ``c`` is moved by ``move`` (SI) and the others follow."""
    problem = fit.problem
    scale = problem.prior_sigma
    held = np.zeros((0, len(scale))) if problem.held is None else problem.held
    own = np.zeros(len(scale))
    own[c] = 1.0
    free = own - held.T @ (held @ own)  # what is unobservable stays; a parameter that is nothing else has no profile
    if free[c] < 1e-6:
        return 0.0
    anchor = fit.values[problem.free] + move / scale[c] / free[c] * free * scale
    start = fit.values.copy()
    start[problem.free] += fit.covariance[:, c] / fit.covariance[c, c] * move
    # The pin must be stiff against what the data say of this parameter, or it yields by several per cent.
    pin = own * (PIN * scale[c] / float(fit.sigma[c]))
    pinned = replace(problem, held=np.vstack([held, pin]), anchor=anchor)
    return float(np.sqrt(max(2.0 * (solve(pinned, start).cost - fit.cost), 0.0)))
