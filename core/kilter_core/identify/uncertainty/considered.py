"""What errors of the masses do to a fit that takes them as exact: considered in its covariance, not estimated (Schmidt).

Beside an effect that follows the sign of a load, masses cannot be carried as parameters without many fits, since no slope
tells where a sign changes. They can be drawn: masses and centres as their standard deviations allow, each draw with the
loads and signs that it has, and the step that the fit would take from there. The values stay as they are, and no fit is
taken again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.effects.load_error import LoadError
from kilter_core.identify.least_squares import Fit, Problem
from kilter_core.identify.problem import HOLD

DRAWS = 100


def beside_drawn_masses(plain: Fit, fit: Fit, errors: LoadError) -> Fit:
    """The ``fit`` with what errors of masses and centres as wide as ``errors`` states add to its covariance.

    ``plain`` is the same fit as it ended. Predictions need none of it: loads that are off act on them as they did on the
    rows, and what that left is known.
    """
    before = plain.problem
    model = replace(before.model, effects=(*before.model.effects, errors))
    problem = Problem(model, before.measurement, before.free, before.weights, before.loss, before.held, before.anchor)
    parameters = errors.parameters(model.robot)
    exact = problem.whitened(np.concatenate([plain.values, np.zeros(len(parameters))]))
    if len(exact) != len(plain.J):
        return fit  # a filter goes on from what it knew
    rng = np.random.default_rng(0)
    half = rng.standard_normal((DRAWS // 2, len(parameters))) * [p.prior_sigma for p in parameters]
    drawn = np.clip(np.vstack([half, -half]), [p.lower for p in parameters], [p.upper for p in parameters])
    left = np.stack([problem.whitened(np.concatenate([plain.values, one])) - exact for one in drawn])
    scaled = plain.J * before.prior_sigma
    H = scaled.T @ scaled + np.eye(scaled.shape[1])
    if before.held is not None:
        H += HOLD * before.held.T @ before.held
    moved = np.linalg.solve(H, scaled.T @ left.T) * before.prior_sigma[:, None]
    return replace(fit, covariance=fit.covariance + moved @ moved.T / len(drawn))
