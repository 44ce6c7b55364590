"""Loads on the fitted chain: taken anew between fits, for what a fit moves of the chain moves the weights that hang on it.

A joint zero of one degree changes moments by percents. Within a fit the chain of the loads stands still, so the Jacobian
stays exact; a fit that moved it goes on with the loads it leads to, until they change nothing that the data could show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.estimate import WEIGHT_PASSES, near, weights_of
from kilter_core.identify.fit.least_squares import Fit, Weights, solve
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import RobotModel

ROUNDS = 3  # of loads: where the poses tell the chain, each moves it a hundredth as far as the one before
# Norm of what new loads move of all rows, in sigmas: no parameter, nor any sum of them, moves by more than this share of
# its own standard deviation.
SETTLED = 0.1


def reloaded(fit: Fit) -> RobotModel | None:
    """The model of a fit with its loads on the chain that was fitted; None where that moves nothing that counts."""
    problem = fit.problem
    if not any("moments" in effect.needs for effect in problem.model.effects):
        return None
    other = replace(problem, model=problem.model.loads_at(fit.values))
    moved = np.linalg.norm(other.whitened(fit.values) - problem.whitened(fit.values))
    return other.model if moved > SETTLED else None


def continued(fit: Fit, model: RobotModel, options: IdentifyOptions) -> Fit:
    """Fit another ``model`` of the same parameters from where a fit ended, its weights following the residuals.

    What that fit held stays held.

    Raises:
        NotConvergedError: no minimum found.

    """
    found = solve(replace(fit.problem, model=model), fit.values)
    walked = found.iterations
    for _ in range(WEIGHT_PASSES):
        problem = found.problem
        weights = weights_of(found, options)
        if _alike(weights, problem.weights):
            break
        found = solve(problem.reweighted(weights, problem.held), found.values, known=found.residual)
        walked += found.iterations
    return replace(found, iterations=walked)


def _alike(one: Weights, other: Weights) -> bool:
    sizes = (float(np.mean(one.points)), float(np.mean(other.points)))
    groups = ((sigma, float(other.of(group))) for group, sigma in one.others.items())
    return near(*sizes) and near(one.turns, other.turns) and all(near(*pair) for pair in groups)
