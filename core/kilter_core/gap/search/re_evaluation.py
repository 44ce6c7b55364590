"""After every name: what is noise, and which readings are wrong, judged again by the model with what it knows by now.

Without repeats the noise is the scatter of the fit. Frozen at the first fit it holds the gap itself: wrong readings do not
show above it, and the next effect hides under the first (an arm of 0.02 mm was said to have 0.08). With repeats a name
that follows the clock or the temperature takes its share out of what they differ by, and what is left of them is the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from kilter_core.gap.budget import PREPARING, Budget, OutOfTimeError
from kilter_core.gap.noise.from_repeats import FIT, Noise, add_approach_noise, noise_again, re_estimate_fit_noise
from kilter_core.gap.noise.visits import isolate_unused_visits
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, ignore_step, linearise_problem, refit
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.rows.outliers import LARGE, outliers, stands_out
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints, Progress

WRONG = "wrong readings beyond those set aside"
CHANGED = 0.02  # of the noise, from which a fit is made again
FREER = 0.1  # of its freedom, from which the same
MANY = 500  # visits above which names do not have them judged again, until the search ends or the noise changes
FITS = 3  # of the geometry without wrong readings
SEEN = 1e-12  # of the largest: smaller eigenvalues are directions that geometry imitates
ROUNDS = 3  # more of noise read from repeats and amounts fitted under it


def refit_with_updated_noise(
    problem: LinearizedProblem, columns: Sequence[int], tick: Tick = ignore_step, at_last: bool = True
) -> LinearizedProblem:
    """The problem re-fitted with noise and outliers as the fit with these columns shows them; itself if unchanged.

    Every visit is judged, also those set aside before: one may come back. A drift in a noise that came from repeats keeps
    the amount of the name that explains it near its prior: the noise that is left of them lets it go, in some rounds.
    Visits are judged by all of the library, named or not: among many they are ``at_last``, and under another noise.
    ``tick`` is called at every step, and may raise: then nothing was judged again.
    """
    before, problem = problem, _update_noise_once(problem, columns, tick, at_last)
    for _ in range(ROUNDS if problem is not before and problem.settings.noise.repeats is not None else 0):
        after = _with_noise(problem.settings, problem, columns, problem.settings.used)
        if _is_noise_unchanged(problem.settings.noise, after.noise):
            break
        problem.resting()
        problem = refit(after, problem.values, columns, tick)
    return problem


def without_wrong(problem: LinearizedProblem, budget: Budget, progress: Progress) -> LinearizedProblem:
    """The geometry fitted without wrong readings, which each fit judges for the next until none changes, or time is over."""
    tick = budget.tick(PREPARING, WRONG)
    for _ in range(FITS):
        try:
            after = refit_with_updated_noise(problem, (), tick)
        except OutOfTimeError:
            break
        if after is problem:
            break
        progress(0.7, "fitting without outliers")
        problem = after
    return problem


def _update_noise_once(
    problem: LinearizedProblem, columns: Sequence[int], tick: Tick, at_last: bool
) -> LinearizedProblem:
    settings = problem.settings
    if settings.inflation > 1.0:  # rows correlated in time: a disturbance looks like what they share
        return problem
    every = replace(settings, used=np.ones(len(settings.used), dtype=bool))
    every = _with_noise(every, problem, columns, settings.used)
    known = not at_last and len(settings.used) > MANY and _is_noise_unchanged(settings.noise, every.noise)
    if known or (len(settings.used) > LARGE and settings.used.all() and not stands_out(every, problem.values)):
        used = settings.used
    else:
        problem.resting()
        used = ~outliers(linearise_problem(every, problem.values), columns, tick)
    after = _with_noise(replace(every, used=used), problem, columns, used)
    if np.array_equal(used, settings.used) and _is_noise_unchanged(settings.noise, after.noise):
        return problem
    problem.resting()
    return refit(after, problem.values, columns, tick)


def under(settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int] = ()) -> LinearizedProblem:
    """A problem re-fitted under the noise and outliers of another, so that the two can be compared."""
    if settings is problem.settings:
        return problem
    problem.resting()
    return refit(settings, problem.values, columns)


def _is_noise_unchanged(before: Noise, after: Noise) -> bool:
    """Whether nothing changed that a verdict could rest on."""
    if before is after:
        return True
    ratio = after.coordinate / max(before.coordinate, 1e-300)
    freedom = after.freedom / before.freedom if before.freedom > 0.0 else 1.0
    if before.kinds and not np.allclose(np.diag(before.row), np.diag(after.row), rtol=2.0 * CHANGED, atol=0.0):
        return False
    was, now = (np.diagonal(noise.visit, axis1=1, axis2=2) for noise in (before, after))
    if before.readings is not None and not np.allclose(was, now, rtol=2.0 * CHANGED, atol=0.0):
        return False
    return abs(ratio - 1.0) < CHANGED and abs(freedom - 1.0) < FREER and before.most == after.most


def _with_noise(
    settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int], used: Bools
) -> ProblemSettings:
    """The noise of the fit where it comes from there, that of repeats without what the fit explains; others stay.

    Where too few repeats are left before anything is named, it is that of the fit: what was read from them all is that of
    the wrong readings (of 15 repeated poses four were approached alike, two of these once wrongly, and a noise of
    0.024 mm was 0.14).
    """
    by_fit = settings.noise.source == FIT
    if settings.noise.repeats is not None:
        noise = _of_repeats(settings, problem, columns, used)
        if noise is not None or columns:
            return settings if noise is None else replace(settings, noise=noise)
        settings, by_fit = replace(settings, trusted=False), True
    if settings.trusted or (not by_fit and settings.noise.readings is None):
        return settings
    residual = unheld(problem, columns, settings.source.residual(problem.values))
    free = problem.U.shape[1] + len(columns)
    lost = min(0.9, free / max(used.sum() * residual.shape[1], 1))
    if not by_fit:
        return replace(settings, noise=add_approach_noise(settings.noise, residual, used, lost))
    return replace(settings, noise=settings.source.even(re_estimate_fit_noise(settings.noise, residual, used, lost)))


def unheld(problem: LinearizedProblem, columns: Sequence[int], residual: Floats) -> Floats:
    """Residuals (V, m) as the library ``columns`` would leave them without their priors; ``residual`` where no visit counts.

    Noise that holds an effect is so large that the effect's prior holds its amount near nothing, which leaves the effect
    in the noise: of 0.027 deg/K 0.0018 were found, with an interval that proved it.
    """
    if not len(columns):
        return residual
    settings, source = problem.settings, problem.settings.source
    G = source.prior.columns(problem.G)
    X = np.hstack([G, problem.W_raw[:, list(columns)]])
    H, b = X.T @ X, X.T @ problem.raw
    own = slice(0, G.shape[1])
    H[own, own] += np.eye(G.shape[1])
    b[own] -= source.prior.whiten_deviation(source.prior.standardized_deviation(source.geometry(problem.values)))
    left = settings.whitening.back(problem.raw - X @ scipy.linalg.lstsq(H, b, cond=SEEN)[0])
    counts = settings.used[:, None] & ~np.isnan(residual)
    return np.where(counts, left, residual)


def _of_repeats(
    settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int], used: Bools
) -> Noise | None:
    """The noise of the repeats at this fit, with equal weights where it had them; None where too few are left."""
    noise = settings.noise
    assert noise.repeats is not None
    pairs = noise.repeats.pairs
    beside = columns if pairs is None else [k for k in columns if k not in pairs.columns]  # it fits those by itself
    taken = fitted_away(problem, beside, noise.repeats.visits.condition)
    left = unheld(problem, columns, settings.source.residual(problem.values))
    again = noise_again(noise, left, taken, used)
    if again is None or again is noise or not np.allclose(noise.visit, noise.even().visit, rtol=1e-9, atol=0.0):
        return again
    return again.even()


def fitted_away(problem: LinearizedProblem, columns: Sequence[int], condition: Ints) -> float:
    """How many scalars of the differences between visits of one ``condition (V,)`` the library columns fit.

    The noise in them is gone from the residual. Geometry fits none: it is the same for all visits of a condition.
    """
    used = problem.settings.used
    basis = problem.basis(columns)[:, problem.U.shape[1] :]
    if not basis.shape[1]:
        return 0.0
    rows = basis.reshape(len(used), -1)
    return float(np.sum(subtract_group_means(rows, isolate_unused_visits(condition, used)) ** 2))
