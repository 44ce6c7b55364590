"""What became of a prior, for results and reports: whose versions, how far believed, and which parameters rest on it.

Where the rows are linear in the parameters, what they say against the type's mean is normal: the noise, and what the type
expects. Along the axes of the latter it falls apart into independent numbers ``u``, of which the type expects a variance
``λ`` beside that of the noise. Their sum of squares over both is the conflict test: a chi-square, over an own one of the few
arms that say what the spread is (Snedecor's F).

Tails are heavy in two ways, both mixtures of normal distributions of other widths. One parameter may be of another make, as
of a joint that was repaired: each in ``RARE`` of them is ``LOOSE`` times as wide (Tukey's contamination), and those are left
to the rows that make the rows likelier so. And all of an arm may be odder than most: Student's t is a normal distribution of
unknown width, averaged over what the rows say of it. An arm beyond all that is fitted without the prior (O'Hagan 1979).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from kilter_core.errors import FindingDocument
from kilter_core.identify.fit.least_squares import Fit, PriorUse
from kilter_core.identify.fleet_prior import FleetPrior, said_left_out
from kilter_core.identify.identifiability import WEAK
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


def prior_warnings(fleet: FleetPrior, fit: Fit) -> Iterator[FindingDocument]:
    """Say when the arm is not as its type, and which versions are in another gauge."""
    use = fit.prior_use
    if use is not None and use.state != "used":
        code = "fleet_prior_dropped" if use.state == "dropped" else "fleet_prior_widened"
        yield FindingDocument.make(code, _sentence(fleet, fit, []))
    if fleet.left_out:
        message = (
            f"{said_left_out(fleet.left_out)} The prior does without. Identify those robots as this one to count them."
        )
        yield FindingDocument.make("fleet_version_left_out", message)


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


CONFLICT = 0.01  # chance of an arm of the type to be as odd, below which the type is not believed
TOO_ODD = 4.0  # times as wide as the type spreads, from which on it is no longer one of the type
NOTICED = 1.05  # widenings below are none
TELLING = 0.1  # variance that the type expects, in those of the noise, from which on a number tells of the arm
RARE, LOOSE = 0.02, 20.0  # share of the parameters that are of another make, and how much wider those are
MOST_ODD = 0.1  # share of the parameters beyond which the arm itself is of another make
TAILS = 4.0  # freedom of Student's t for a whole arm
CONFLICT_WIDTHS = np.geomspace(1.0, 30.0, 30)
NOISES = np.geomspace(0.02, 10.0, 60)  # times that of the fit: of few poses it is hardly known
FLAT = 1e-9  # share of the largest singular value of the other parameters' columns that counts as zero


@dataclass(frozen=True)
class Told:
    """What rows say against a type: ``y (K,)`` in noise sigmas of the fit, ``R (K, K)`` what the type's parameters move of it,
    and the sum of squares ``left`` of ``spare`` numbers that only noise moves.
    """

    y: Floats
    R: Floats
    left: float
    spare: int

    def axes(self, covariance: Floats) -> tuple[Floats, Floats]:
        """Independent numbers ``u (K,)``, and the variances (K,) that a type of this ``covariance (K, K)`` expects."""
        expected, V = np.linalg.eigh(self.R @ covariance @ self.R.T)
        return np.asarray(V.T @ self.y), np.maximum(expected, 0.0)

    def likelihood(self, covariance: Floats, noises: Floats, widths: Floats) -> Floats:
        """Logarithm (T, S) of the likelihood of noises times widths of a type."""
        u, expected = self.axes(covariance)
        variance = noises[:, None, None] ** 2 + widths[None, :, None] ** 2 * expected
        log = -0.5 * np.sum(np.log(variance) + u**2 / variance, axis=2)
        return np.asarray(log - 0.5 * (self.spare * np.log(noises**2) + self.left / noises**2)[:, None])


def reduce_to_prior_parameters(fit: Fit, prior: CorrelatedPrior) -> Told:
    """What the rows of a ``fit`` say against a ``prior``; all other parameters take up what they can."""
    problem = fit.problem
    known, own = prior.places(fit.names)
    here = problem.linearise(fit.values)
    columns = here.J[:, known]
    left = here.r + columns @ (fit.values[problem.free][known] - prior.mean[own])
    others = np.delete(here.J, known, axis=1) * np.delete(problem.prior_sigma, known)
    U, s, _ = np.linalg.svd(others, full_matrices=False)
    U = U[:, s > FLAT * max(float(s.max(initial=0.0)), 1.0)]
    Q, R = np.linalg.qr(columns - U @ (U.T @ columns))
    left = left - U @ (U.T @ left)
    y = Q.T @ left
    spare = problem.measurement.scalars() - U.shape[1] - len(y)
    return Told(np.asarray(y), np.asarray(R), max(float(left @ left - y @ y), 0.0), max(spare, 0))


def assess_prior_conflict(fit: Fit, prior: CorrelatedPrior, noise_known: bool) -> PriorUse:
    """How far to believe a ``prior`` of the arm that was fitted without it; with ``noise_known`` the fit's weights are true."""
    told, own = reduce_to_prior_parameters(fit, prior), prior.places(fit.names)[1]
    noises = np.ones(1) if noise_known else NOISES
    names = [prior.names[k] for k in own]
    odd = _odd_ones(told, prior, names, noises)
    covariance = prior.widen_parameters(odd, LOOSE).covariance[np.ix_(own, own)]
    likely = told.likelihood(covariance, noises, CONFLICT_WIDTHS) - 0.5 * TAILS * (
        np.log(CONFLICT_WIDTHS**2) + 1.0 / CONFLICT_WIDTHS**2
    )
    likely = np.exp(likely - likely.max())
    noise = noises[int(np.argmax(likely.sum(axis=1)))]
    u, expected = told.axes(covariance)
    telling = expected > TELLING
    count = int(np.count_nonzero(telling))
    square = float(np.sum(u[telling] ** 2 / (noise**2 + expected[telling])))
    p = float(fdtrc(count, prior.freedom, square / count)) if count else 1.0
    width = float(np.sum(likely) / np.sum(likely / CONFLICT_WIDTHS**2)) ** 0.5
    if p < CONFLICT or width > TOO_ODD or len(odd) >= MOST_ODD * len(names):
        return PriorUse("dropped", None, square, count, p)
    if width < NOTICED and not odd:
        return PriorUse("used", 1.0, square, count, p, noise=float(noise))
    return PriorUse("widened", width, square, count, p, tuple(odd), noise=float(noise))


def _odd_ones(told: Told, prior: CorrelatedPrior, names: list[str], noises: Floats) -> list[str]:
    """Parameters that make the rows likelier when they are of another make, the likeliest first."""
    own, odd, one = prior.places(names)[1], list[str](), np.ones(1)

    def likelihood(loose: list[str]) -> float:
        covariance = prior.widen_parameters(loose, LOOSE).covariance[np.ix_(own, own)]
        return float(np.logaddexp.reduce(told.likelihood(covariance, noises, one)[:, 0]))

    here = likelihood(odd)
    while len(odd) < MOST_ODD * len(names):
        found = {name: likelihood([*odd, name]) for name in names if name not in odd}
        best = max(found, key=lambda name: found[name])
        if found[best] + math.log(RARE) <= here:
            break
        odd, here = [*odd, best], found[best]
    return odd
