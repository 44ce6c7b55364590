"""Signs of loads while masses are uncertain: as soft as the masses leave the loads, from their priors to what the data say.

An effect with a sharp sign is blind to the masses that decide where it changes: its loss is flat but for steps, so a fit
stays with the masses it began with. Read as its expectation over the masses the sign is a smooth curve; a fit finds the
masses by it, which then leave the loads less uncertain and the sign sharper, until nothing changes any more. Where the
masses are as stated nothing of that is needed: of the two fits the likelier stands.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kilter_core.identify.carried_masses import of_masses
from kilter_core.identify.estimate import scatter
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.model import RobotModel
from kilter_core.model.load_errors import load_sign_blur
from kilter_core.observations import Observations
from kilter_core.types import Floats

SHARPENINGS = 4
CHANGED = 0.1  # of a width: less moves no sign that matters


def model_with_softened_signs(fit: Fit) -> RobotModel | None:
    """The model of a fit with signs as soft as the priors of the masses leave the loads; None where no sign is in doubt."""
    problem = fit.problem
    own = of_masses(problem.model)[problem.free]
    if not own.any():
        return None
    model = problem.model
    made = _as_soft(model, model, problem.measurement.observations, fit.values, np.diag(problem.prior_sigma[own] ** 2))
    return made if np.any(_widths(made) > _widths(model)) else None


def model_with_sharpened_signs(fit: Fit, sharp: RobotModel, reloaded: RobotModel | None) -> RobotModel | None:
    """The model of a fit with signs as soft as its posterior of the masses leaves the loads; None where nothing changes.

    ``sharp`` has the effects with widths of their own, below which none goes; ``reloaded`` is the model with its loads on
    the chain that was fitted, where those differ.
    """
    problem = fit.problem
    own = of_masses(problem.model)[problem.free]
    known = fit.covariance[np.ix_(own, own)]
    model = problem.model if reloaded is None else reloaded
    made = _as_soft(model, sharp, problem.measurement.observations, fit.values, known)
    before, after = _widths(problem.model), _widths(made)
    return reloaded if np.all(np.abs(after - before) <= CHANGED * before) else made


def likelier(one: Fit, other: Fit) -> bool:
    """Whether the first fit is likelier than the other: by what each leaves of the rows, and by their priors."""
    return _surprise(one) < _surprise(other)


def _surprise(fit: Fit) -> float:
    """Minus the logarithm of the posterior density, up to a constant, each noise group with the scatter that it shows."""
    problem, left = fit.problem, scatter(fit)
    moved = (fit.values[problem.free] - problem.prior_mean) / problem.prior_sigma
    seen = sum(
        float(np.count_nonzero(~np.isnan(block.r))) * math.log(max(left[block.group], TINY))
        for block in fit.residual.blocks
    )
    return seen + 0.5 * float(moved @ moved)


TINY = 1e-12


def _as_soft(
    model: RobotModel, sharp: RobotModel, rows: Observations, values: Floats, covariance: Floats
) -> RobotModel:
    batch = model.apply_load_errors(model.batch(rows), values)
    soft = replace(batch, blur=load_sign_blur(model.effects, batch, covariance))
    return replace(model, effects=tuple(effect.with_softened_signs(soft) for effect in sharp.effects))


def _widths(model: RobotModel) -> Floats:
    """Half-widths of the signs, N m, joint by joint of each effect that has one."""
    n = model.robot.n_joints
    found = (np.broadcast_to(effect.softening_nm, len(effect.acting(n)))
             for effect in model.effects if hasattr(effect, "softening_nm"))  # fmt: skip
    return np.concatenate([np.zeros(0), *found])
