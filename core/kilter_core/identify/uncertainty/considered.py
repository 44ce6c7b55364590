"""What errors of the masses do to a fit that takes them as exact: considered in its covariance, not estimated (Schmidt).

Beside an effect that follows the sign of a load, masses cannot be carried as parameters without many fits, since no slope
tells where a sign changes. They can be drawn: masses and centres as their standard deviations allow, each draw with the
loads and signs that it has, and the step that the fit would take from there, by the slopes that it has there: an amplitude
that wrong signs have put near zero is seen by the right ones only. The values stay as they are, and no fit is taken again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.effects.load_error import LoadError
from kilter_core.identify.fit.least_squares import Fit, Problem

DRAWS = 60


def beside_drawn_masses(plain: Fit, fit: Fit, errors: LoadError) -> Fit:
    """The ``fit`` with what errors of masses and centres as wide as ``errors`` states add to its covariance.

    ``plain`` is the same fit as it ended. Predictions need none of it: loads that are off act on them as they did on the
    rows, and what that left is known.
    """
    before = plain.problem.wholly()
    model = replace(before.model, effects=(*before.model.effects, errors))
    moving = before.free >= model.n_geometric  # what loads act through; the chain's own columns hardly follow them
    problem = Problem(model, before.measurement, before.free[moving], before.weights, before.loss, whole=True)
    if len(plain.J) > sum(block.r.size for block in plain.residual.blocks):
        return fit  # a filter goes on from what it knew
    parameters = errors.parameters(model.robot)
    rng = np.random.default_rng(0)
    half = rng.standard_normal((DRAWS // 2, len(parameters))) * [p.prior_sigma for p in parameters]
    drawn = np.clip(np.vstack([half, -half]), [p.lower for p in parameters], [p.upper for p in parameters])
    J, steps = before.linearise(plain.values, plain.residual).J.copy(), []
    for one in drawn:
        here = problem.linearise(np.concatenate([plain.values, one]))
        J[:, moving] = here.J
        steps.append(np.linalg.solve(*before.derivatives(plain.values, replace(here, J=J))))
    moved = np.array(steps) * before.prior_sigma
    return replace(fit, covariance=fit.covariance + moved.T @ moved / len(drawn))
