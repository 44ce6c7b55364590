"""How far a type may move an arm: by no more than a share of what its own rows leave open.

A prior is right on average over the arms of its type, and wrong for some: one zero of another make may show as odd in no row,
and still pull at all others. Whatever the arm is, an estimate that is never moved by more than ``MOST`` times the expected
error of the estimate without has hardly more than sqrt(1 + MOST²) times that error, so the loss is bounded and most of the
gain is kept (limited translation: Efron and Morris, J. Am. Stat. Assoc. 67 (1972) 130). Instead of cutting the move off, the
type is taken wider until it moves the tool by that much, so that intervals follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.observations import Observations
from kilter_core.parameters import Prior, TypePrior
from kilter_core.types import Floats

MOST = 0.26  # times the expected error without the type that this may move the tool by: 3 % more on average
WIDTHS = np.geomspace(1.0, 30.0, 35)  # 10 % apart; the widest is about an ordinary prior
POSES = 200  # where both are compared, between the joint readings of the rows


def required_prior_widening(alone: Fit, prior: TypePrior, noise: float) -> float:
    """How many times as wide a ``prior`` has to be taken beside the fit without it; linear about that fit.

    ``noise`` is that of the rows in those of the fit: what few poses leave tells it badly, and the type tells more of it.
    """
    problem = alone.problem
    values, here = alone.values[problem.free], problem.linearise(alone.values)
    parameters = [problem.model.parameters[k] for k in problem.free]
    G = _tool(alone)
    most = (MOST * noise) ** 2 * float(np.einsum("ik,kl,il->", G, alone.covariance, G))
    for width in WIDTHS:
        known = Prior.from_parameters(parameters, prior.widen_by_factor(float(width)))
        J = here.J * known.sigma / noise
        H = J.T @ J
        known.add_to(H)
        step = known.sigma * np.linalg.solve(
            H, J.T @ here.r / noise - known.stiff(known.standardized_deviation(values))
        )
        if float(np.sum((G @ step) ** 2)) <= most:
            return float(width)
    return float(WIDTHS[-1])


def _tool(fit: Fit) -> Floats:
    """Derivatives (3 M, F) of the tool's place by the free parameters, at random poses between the readings of the rows."""
    rows = fit.problem.measurement.observations
    rng = np.random.default_rng(0)
    some = rows.select(rng.integers(len(rows), size=POSES))  # their loads and conditions
    q = rng.uniform(rows.q.min(axis=0), rows.q.max(axis=0), (POSES, rows.q.shape[1]))
    at: Observations = replace(some, q=q)
    J = fit.problem.model.jacobian(at, fit.values, fit.problem.free, False)[1]
    return np.asarray(J[:, :3].reshape(-1, len(fit.problem.free)))
