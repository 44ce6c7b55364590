"""Loads on the fitted chain: taken anew between fits, for what a fit moves of the chain moves the weights that hang on it.

A joint zero of one degree changes moments by percents. Within a fit the chain of the loads stands still, so the Jacobian
stays exact; a fit that moved it goes on with the loads it leads to, until they change nothing that the data could show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.estimate import WEIGHT_PASSES, estimate_weights, has_sigma_settled
from kilter_core.identify.fit.least_squares import Fit, Weights, solve
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import RobotModel

ROUNDS = 3  # of loads: where the poses tell the chain, each moves it a hundredth as far as the one before
# Norm of what new loads move of all rows, in sigmas: no parameter, nor any sum of them, moves by more than this share of
# its own standard deviation.
SETTLED = 0.1


def model_with_updated_loads(fit: Fit) -> RobotModel | None:
    """The model of a fit with its loads on the chain that was fitted; None where that moves nothing that counts."""
    problem = fit.problem
    if not any("moments" in effect.needs for effect in problem.model.effects):
        return None
    other = replace(problem, model=problem.model.with_loads_at_values(fit.values))
    moved = np.linalg.norm(other.whitened_residuals(fit.values) - problem.whitened_residuals(fit.values))
    return other.model if moved > SETTLED else None


def continue_fit(fit: Fit, model: RobotModel, options: IdentifyOptions) -> Fit:
    """Fit another ``model`` of the same parameters from where a fit ended, its weights following the residuals.

    What that fit held stays held.

    Raises:
        NotConvergedError: no minimum found.

    """
    found = solve(replace(fit.problem, model=model), fit.values)
    walked = found.iterations
    for _ in range(WEIGHT_PASSES):
        problem = found.problem
        weights = estimate_weights(found, options)
        if _are_weights_settled(weights, problem.weights):
            break
        found = solve(problem.with_weights(weights, problem.held), found.values, known=found.residual)
        walked += found.iterations
    return replace(found, iterations=walked)


def _are_weights_settled(one: Weights, other: Weights) -> bool:
    sizes = (float(np.mean(one.points)), float(np.mean(other.points)))
    groups = ((sigma, float(other.group_sigma(group))) for group, sigma in one.others.items())
    return (
        has_sigma_settled(*sizes)
        and has_sigma_settled(one.turns, other.turns)
        and all(has_sigma_settled(*pair) for pair in groups)
    )
