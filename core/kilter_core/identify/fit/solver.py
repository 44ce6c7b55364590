"""One way to step towards a minimum: Levenberg and Marquardt, then Newton where the valley is curved.

Constants of a chain that the tool's frame makes up for lie in a valley a million times as steep across as along, and it
bends: a straight step leaves its floor, and only short ones lower the loss. So once steps gain little, damping no longer
holds those directions the most that the data see the least, and a step is bent until it ends on the floor again.

Gauss and Newton leave out the curvature of the residuals themselves. Along directions that the data hardly see, what
is left unexplained times that curvature is as large as all they keep: the loss then falls by a part in a thousand a
step, for hundreds of steps (poses on a grid, lines at one orientation). After a few such steps the whole second
derivative is taken, by differences of the slope; its negative directions are reversed (Dauphin et al. 2014, saddle-free
Newton), and a few steps end it. The loss never rises: a step that would raise it is shortened, or not taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

import numpy as np

from kilter_core.errors import NotConvergedError
from kilter_core.types import Floats

StepProgress = Callable[[int, float], None]

MAX_ITERATIONS = 60
PATIENCE = 8  # slow steps before the second derivative is taken, which costs a look at the model for every direction
SLOW = 0.2  # share of the loss that a step must take off not to be slow,
FADING = 0.1  # or gain less than this share of the step before: so a descent ends that is about to
ROUNDING = 1e-13  # share of the loss that a step must promise to be worth taking
LAST = 1e-9  # share below which the step is taken and the model not asked again: it is linear that near
STEP_TOLERANCE = 1e-9  # largest step, in prior sigmas, that counts as converged
DIFFERENCE = 1e-6  # prior sigmas ahead, where the slope gives the second derivative: by 1e-4 a valley bends away
LASTING = 3  # steps that a curvature is used for: near the end it hardly changes
FIRST_DAMPING = 1e-6
SHORTENINGS = 25
BEND = 0.1  # share of a step over which its bend is measured
TURNS = 6  # times that a step is bent back to the floor of the valley,
ON_FLOOR = 0.01  # until the height over it is less than this share of what the step promises,
NEARER = 0.5  # or is more than this share of the height before: then it is too long for that
WEAK = 10.0  # second derivative, per row, above which the curvature of the residuals adds nothing that matters
NOTHING = 1e-5  # of loss: it moves no parameter by more than 0.005 of its standard deviation
TOO_BENT = 1.5  # of the step: an acceleration beyond this says that the step is too long for it


class Point(Protocol):
    """What an objective knows at some values."""

    @property
    def loss(self) -> float:
        """Value of the objective."""


P = TypeVar("P", bound=Point)


class Objective(Protocol[P]):
    """What is minimised. Steps are in prior sigmas, so the prior adds the identity to the second derivative."""

    @property
    def rows(self) -> float:
        """Number of whitened residuals, which is about the sum of their squares at the minimum."""

    def required_decrease(self, loss: float) -> float:
        """How much of ``loss`` a step must promise to be worth taking, beside rounding."""

    def evaluate(self, values: Floats) -> P:
        """Look at ``values``: the loss there, and what its derivatives need."""

    def derivatives(self, values: Floats, here: P) -> tuple[Floats, Floats]:
        """Gauss-Newton matrix (F, F) and downhill slope (F,) at a point."""

    def slope(self, values: Floats, here: P) -> Floats:
        """Downhill slope (F,) alone."""

    def apply_step(self, values: Floats, step: Floats) -> Floats:
        """Values after a step (F,)."""

    def bend(self, values: Floats, here: P, step: Floats) -> Floats:
        """Jᵀ times the second derivative (F,) of the prediction along a step: how far off the tangent the valley bends."""

    def surely_higher(self, values: Floats, loss: float) -> bool:
        """Whether the loss at ``values`` is known to be higher, without what derivatives need; where it is dear, False."""

    def beyond(self, here: P, values: Floats, step: Floats) -> P:
        """Predict what is at ``values``, a tiny ``step`` from ``here``, without asking the model again."""


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where a descent ended; ``step (F,)`` is its last. Not ``converged``: it was still falling at the iteration limit."""

    values: Floats
    point: P
    iterations: int
    step: Floats
    converged: bool = True


@dataclass(frozen=True)
class _Step(Generic[P]):
    """A step taken: the values after it and what is there; whether it was the last; the damping for the next."""

    values: Floats
    point: P
    step: Floats
    last: bool
    damping: float


def minimise(
    objective: Objective[P],
    start: Floats,
    here: P,
    progress: StepProgress | None = None,
    enough: float = 0.0,
    patience: int = PATIENCE,
    idle: int = MAX_ITERATIONS,
) -> Minimum[P]:
    """Walk downhill from ``start``, where ``here`` is known, to a minimum; the loss never rises.

    ``enough`` ends the walk early, once a step takes less than this share off the loss. ``patience`` is the number of slow
    steps before the second derivative is taken, ``idle`` that of steps in a row that did not gain what is worth taking, though
    they promised it, after which the walk ends.

    Raises:
        NotConvergedError: numbers that are not finite.

    """
    values, damping, slow, last, before = start, FIRST_DAMPING, 0, np.zeros(0), np.inf
    curved, age, vain = np.zeros(0), 0, 0
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not np.isfinite(here.loss):
            raise NotConvergedError("The residuals are not finite: check the observations for impossible values.")
        H, g = objective.derivatives(values, here)
        if not slow:
            taken = _marquardt(objective, values, here, H, g, damping)
        elif slow < patience:
            taken = _newton(objective, values, here, H, g)
        else:
            if age % LASTING == 0:
                curved = with_curvature(objective, values, here, H) - H
            age += 1
            taken = _newton(objective, values, here, H + curved, g)
            if taken is None and age % LASTING != 1:  # no end to be believed of an old curvature
                age = 0
                continue
        if progress is not None:
            progress(iteration, here.loss)
        if taken is None:
            return Minimum(values, here, iteration, last)
        gained = here.loss - taken.point.loss
        values, here, damping, last = taken.values, taken.point, taken.damping, taken.step
        vain = vain + 1 if gained < objective.required_decrease(here.loss) else 0
        if taken.last or gained < enough * here.loss or vain == idle:
            return Minimum(values, here, iteration, last)
        slow += FADING * before < gained < SLOW * here.loss
        before = gained
    return Minimum(values, here, MAX_ITERATIONS, last, False)


def _marquardt(
    objective: Objective[P], values: Floats, here: P, H: Floats, g: Floats, damping: float
) -> _Step[P] | None:
    """Raise the damping until a step lowers the loss; None where no step does: a minimum to rounding."""
    diagonal = np.diag(H)
    for attempt in range(SHORTENINGS):
        damped = H.copy()
        damped.flat[:: len(H) + 1] += damping * diagonal
        step = np.asarray(np.linalg.solve(damped, g), dtype=np.float64)
        if _worthless(objective, here, step, g):
            return None
        if float(step @ g) < LAST * (1.0 + here.loss) and damping < 1e-3:
            trial = objective.apply_step(values, step)
            return _Step(trial, objective.beyond(here, trial, step), step, True, damping)
        trial = objective.apply_step(values, step)
        # Nearly every step is good, so its Jacobian is taken at once instead of after its loss; after one that was not, not.
        if not (attempt and objective.surely_higher(trial, here.loss)):
            there = objective.evaluate(trial)
            if there.loss < here.loss:
                return _Step(trial, there, step, False, damping * 0.1)
        damping = max(damping * 10.0, 1e-9)
    return None


def _newton(objective: Objective[P], values: Floats, here: P, H: Floats, g: Floats) -> _Step[P] | None:
    """A step with the second derivative ``H``, whole or as Gauss and Newton have it, shortened until it gains.

    Its negative directions are reversed, and all are damped alike.
    """
    w, V = np.linalg.eigh(H)
    size = np.maximum(np.abs(w), 1.0)  # the prior alone gives 1
    damping = 0.0
    for attempt in range(SHORTENINGS):
        step = _over(V, size + damping, g)
        if _worthless(objective, here, step, g):
            return None
        last = float(step @ g) < LAST * (1.0 + here.loss)
        if not last:
            step = _bent(objective, values, here, step, g, partial(_over, V, size + damping))
        trial = objective.apply_step(values, step)
        if not (attempt and objective.surely_higher(trial, here.loss)):
            there = objective.evaluate(trial)
            if there.loss < here.loss:
                # Where the loss has kinks (Huber's) full steps go to and fro across one for ever smaller gains.
                return _Step(trial, there, step, last or here.loss - there.loss < NOTHING, FIRST_DAMPING)
        damping = max(damping * 10.0, 1.0)
    return None


def _over(V: Floats, size: Floats, b: Floats) -> Floats:
    """Solve with the matrix of eigenvectors ``V (F, F)`` and eigenvalues ``size (F,)``."""
    return np.asarray(V @ ((V.T @ b) / size))


def _bent(
    objective: Objective[P], values: Floats, here: P, step: Floats, g: Floats, solve: Callable[[Floats], Floats]
) -> Floats:
    """Bend a step back to the floor of the valley: what its end is off the tangent is taken off again, a few times over.

    Where the step is too long for that, half the geodesic acceleration is added (Transtrum, Machta and Sethna 2011).
    """
    bent, off, height = step, np.zeros_like(step), np.inf
    for _ in range(TURNS):
        other = 0.5 * BEND**2 * objective.bend(values, here, bent / BEND)
        after = step - solve(other)
        before, height = height, float((bent - after) @ (other - off))
        if not height <= NEARER * before:
            return _add_geodesic_acceleration(objective, values, here, step, solve)
        bent, off = after, other
        if height <= ON_FLOOR * float(step @ g):
            break
    return bent


def _add_geodesic_acceleration(
    objective: Objective[P], values: Floats, here: P, step: Floats, solve: Callable[[Floats], Floats]
) -> Floats:
    acceleration = -solve(objective.bend(values, here, step))
    if 2.0 * np.linalg.norm(acceleration) > TOO_BENT * np.linalg.norm(step):
        return step
    return step + 0.5 * acceleration


def _worthless(objective: Objective[P], here: P, step: Floats, g: Floats) -> bool:
    promised = float(step @ g)
    worth = max(ROUNDING * (1.0 + here.loss), objective.required_decrease(here.loss))
    return promised < worth or float(np.max(np.abs(step), initial=0.0)) < STEP_TOLERANCE


def with_curvature(objective: Objective[P], values: Floats, here: P, H: Floats) -> Floats:
    """``H (F, F)`` with the curvature of the residuals along the directions in which it can matter.

    It is at most about the number of rows (times what one prior sigma bends, in noise sigmas): directions that the data
    see far better are left as they are. Along each of the others the slope is compared with that ``here``.
    """
    live = np.flatnonzero(np.abs(H - np.eye(len(H))).max(axis=1) > 0.0)  # of the others the data see nothing at all
    w, E = np.linalg.eigh(H[np.ix_(live, live)])
    V = np.eye(len(H))[:, live] @ E
    weak = np.flatnonzero(w < WEAK * objective.rows)
    M, slope = np.diag(w), objective.slope(values, here)
    for k in weak:
        ahead = objective.apply_step(values, DIFFERENCE * V[:, k])
        M[:, k] = V.T @ (slope - objective.slope(ahead, objective.evaluate(ahead))) / DIFFERENCE
    M[np.ix_(weak, weak)] = 0.5 * (M[np.ix_(weak, weak)] + M[np.ix_(weak, weak)].T)
    M[weak, :] = M[:, weak].T
    if not np.all(np.isfinite(M)):
        return H
    out = H.copy()
    out[np.ix_(live, live)] = E @ M @ E.T
    return out
