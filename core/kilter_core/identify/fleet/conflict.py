"""Whether an arm is as its type, and how far to believe the type where it nearly is.

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
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from kilter_core.identify.fit.least_squares import Fit, PriorUse
from kilter_core.parameters import CorrelatedPrior
from kilter_core.types import Floats

CONFLICT = 0.01  # chance of an arm of the type to be as odd, below which the type is not believed
TOO_ODD = 4.0  # times as wide as the type spreads, from which on it is no longer one of the type
NOTICED = 1.05  # widenings below are none
TELLING = 0.1  # variance that the type expects, in those of the noise, from which on a number tells of the arm
RARE, LOOSE = 0.02, 20.0  # share of the parameters that are of another make, and how much wider those are
MOST_ODD = 0.1  # share of the parameters beyond which the arm itself is of another make
TAILS = 4.0  # freedom of Student's t for a whole arm
WIDTHS = np.geomspace(1.0, 30.0, 30)
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
    likely = told.likelihood(covariance, noises, WIDTHS) - 0.5 * TAILS * (np.log(WIDTHS**2) + 1.0 / WIDTHS**2)
    likely = np.exp(likely - likely.max())
    noise = noises[int(np.argmax(likely.sum(axis=1)))]
    u, expected = told.axes(covariance)
    telling = expected > TELLING
    count = int(np.count_nonzero(telling))
    square = float(np.sum(u[telling] ** 2 / (noise**2 + expected[telling])))
    p = float(fdtrc(count, prior.freedom, square / count)) if count else 1.0
    width = float(np.sum(likely) / np.sum(likely / WIDTHS**2)) ** 0.5
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
