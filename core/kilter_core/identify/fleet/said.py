"""What became of a prior, for results and reports: whose versions, how far believed, and which parameters rest on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet.conflict import NOTICED
from kilter_core.identify.fleet.prior import FleetPrior, said_left_out
from kilter_core.identify.identifiable.identifiability import WEAK
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior, Prior
from kilter_core.types import Bools, Floats

ORDINARY = 0.5  # chance of an arm of the type to be as odd, from which on it is odder than fewer than half of them

MOST = 0.26  # times the expected error without the type that this may move the tool by: 3 % more on average
WIDTHS = np.geomspace(1.0, 30.0, 35)  # 10 % apart; the widest is about an ordinary prior
POSES = 200  # where both are compared, between the joint readings of the rows


def resting(fit: Fit) -> Bools:
    """Which parameters (F,) of a fit rest on its type."""
    return prior_dominated_mask(fit.problem.model.of_type, fit.names, fit.sigma, fit.problem.prior_sigma)


def prior_dominated_mask(
    prior: CorrelatedPrior | None, names: Sequence[str], sigma: Floats, prior_sigma: Floats
) -> Bools:
    """Which parameters (F,) rest on a type: the rows take off less than half of the variance that it leaves them.

    Of those that no arm of the type could tell it says nothing.
    """
    if prior is None:
        return np.zeros(len(names), dtype=bool)
    told = np.isin(names, prior.names) & ~np.isin(names, prior.untold)
    return np.asarray(told & (1.0 - (sigma / prior_sigma) ** 2 < WEAK))


def prior_document(fleet: FleetPrior, fit: Fit) -> dict[str, Any]:
    """The prior of the contract."""
    names = [name for name, rests in zip(fit.names, resting(fit), strict=True) if rests]
    use = {} if fit.prior_use is None else fit.prior_use.to_document()
    return {
        "source": "fleet",
        **use,
        "parameters": names,
        "sentence": _sentence(fleet, fit, names),
        **fleet.to_document(),
    }


def prior_warnings(fleet: FleetPrior, fit: Fit) -> Iterator[dict[str, Any]]:
    """Say when the arm is not as its type, and which versions are in another gauge."""
    use = fit.prior_use
    if use is not None and use.state != "used":
        code = "fleet_prior_dropped" if use.state == "dropped" else "fleet_prior_widened"
        yield {"code": code, "message": _sentence(fleet, fit, [])}
    if fleet.left_out:
        message = (
            f"{said_left_out(fleet.left_out)} The prior does without. Identify those robots as this one to count them."
        )
        yield {"code": "fleet_version_left_out", "message": message}


def _sentence(fleet: FleetPrior, fit: Fit, names: list[str]) -> str:
    use, robots = fit.prior_use, f"{len(fleet.versions)} robots of this type"
    if use is None:
        return f"The prior comes from {robots}."
    compared = f"chi-square {use.chi_square:.3g} in {use.compared} directions, p = {use.p_value:.2g}"
    if use.state == "dropped":
        return (
            f"This arm is not as the {robots} ({compared}): it was identified without them. Ask what was done to it, a "
            "repair or another batch, before others are identified with it."
        )
    said = f"The prior comes from {robots} ({compared})"
    if use.odd:
        said += f"; {', '.join(use.odd)} {'is' if len(use.odd) == 1 else 'are'} not as in those, so there these rows alone say"
    if use.widened_by is not None and use.widened_by >= NOTICED:
        own = use.widened_by / use.limited_by
        # Heavy tails widen an ordinary arm's type too.
        odder = "this arm is odder than most, so " if use.p_value < ORDINARY and own >= NOTICED else ""
        said += f"; {odder}the type's standard deviations count {use.widened_by:.2g} times"
        if use.limited_by > 1.0:
            said += (
                f" ({use.limited_by:.2g} times for that the type may move the tool by {MOST:g} of the error that is expected "
                "without it, and no more)"
            )
    if names:
        verb = "rests" if len(names) == 1 else "rest"
        said += f". {', '.join(names)} {verb} on the prior, not on these rows"
    return said + "."


# How far a type may move an arm: by no more than a share of what its own rows leave open.
# A prior is right on average over the arms of its type, and wrong for some: one zero of another make may show as odd
# in no row, and still pull at all others. Whatever the arm is, an estimate that is never moved by more than ``MOST``
# times the expected error of the estimate without has hardly more than sqrt(1 + MOST²) times that error, so the loss
# is bounded and most of the gain is kept (limited translation: Efron and Morris, J. Am. Stat. Assoc. 67 (1972) 130).
# Instead of cutting the move off, the type is taken wider until it moves the tool by that much, so that intervals
# follow.


def required_prior_widening(alone: Fit, prior: CorrelatedPrior, noise: float) -> float:
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
