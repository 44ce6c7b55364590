"""The last fit, made again until it changes no more: with signs of loads, then with priors, as the data leave them.

The prior of an amplitude says how large it usually is, and keeps what the rows hardly show near zero while a search tries
one effect after another. Of one that was named, twenty times larger than usual, it took several standard deviations, and
where the rows know it less well than the prior does, nearly all. Shapes without a cause keep their priors, and so do
amplitudes that the rows do not tell from zero by themselves: without them, curves of a joint that imitate one another and
the geometry ran to the ends of their ranges, and the error of a real arm from 0.4 to 2.7 mm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from kilter_core.gap.evidence.fits.final_fit import by_rows, jacobian_prior_covariance
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.ranges import library_parameters
from kilter_core.gap.search.masses import blur_load_signs
from kilter_core.gap.search.re_evaluation import under
from kilter_core.gap.search.sources.source import Source
from kilter_core.types import Bools

CHANGED = 0.05  # of a blur: less moves no sign that matters
SIGN_PASSES = 3  # narrower signs show the masses better, which narrows them again
LARGER = 1.5  # times the prior deviation, from which an amplitude has a prior of its own size
TOLD = 3.0  # of its standard deviations by the rows alone, beside those of all other names, from which they tell it
WIDTH = 2.0  # of what the rows ask for: a prior that takes less than a tenth of a standard deviation of what is told
PRIOR_PASSES = 2  # the first still finds it pulled


def narrow_sign_uncertainty(found: SearchResult) -> SearchResult:
    """The search with the blur of its signs made again from the posterior of the masses, and re-fitted; itself if unchanged.

    While it searches the blur is that of the priors, because what is not named yet would narrow
    nothing, or the wrong masses.
    """
    return repeat_until_unchanged(_narrow_signs_once, found, SIGN_PASSES)


def _narrow_signs_once(found: SearchResult) -> SearchResult:
    problem = found.problem
    source = problem.settings.source
    if not found.chosen or source.batch.blur is None:
        return found
    loads = np.flatnonzero(source.of_loads)
    after = blur_load_signs(source, problem.values, jacobian_prior_covariance(found)[2][np.ix_(loads, loads)])
    before = source.batch.blur
    if after.batch.blur is None or np.all(np.abs(after.batch.blur - before) <= CHANGED * before):
        return found
    return refit_under_source(found, after)


def refit_with_wider_priors(found: SearchResult) -> SearchResult:
    """The search with named amplitudes as likely as they came out, fitted again; itself where none is unusually large.

    A fit that leaves more than the one before is none.
    """
    return repeat_until_unchanged(_widen_priors_once, found, PRIOR_PASSES)


def _physical_column_mask(found: SearchResult) -> Bools:
    """Which columns (d,) are of effects with a cause: how large a shape without one is, nobody asks."""
    candidates = found.selector.scorer.candidates
    shapes = {column for k in found.chosen if candidates[k].empirical for column in candidates[k].columns}
    return np.array([column not in shapes for column in found.columns], dtype=bool)


def _group_comparable_columns(found: SearchResult) -> Iterator[list[int]]:
    """Library columns of what was named, those together that are as large as one another: of one effect, in one unit.

    Where rows tell one component of a tilt, the prior of the other would tell it to be a fifteenth of what it was.
    """
    source, candidates = found.problem.settings.source, found.selector.scorer.candidates
    library = library_parameters(source)
    for k in found.chosen:
        for effect in candidates[k].effects:
            own = {p.name: p.unit for p in effect.parameters(source.model.robot)}
            columns = [column for column in candidates[k].columns if library[column].name in own]
            for unit in dict.fromkeys(own.values()):
                alike = [column for column in columns if own[library[column].name] == unit]
                if alike:
                    yield alike


def _widen_priors_once(found: SearchResult) -> SearchResult:
    problem, columns = found.problem, found.columns
    if not columns:
        return found
    source, prior = problem.settings.source, problem.settings.source.library_sigma
    asked, unsure = by_rows(found)
    far = (asked > TOLD * unsure) & (asked > LARGER * prior[columns]) & _physical_column_mask(found)
    if not np.any(far):
        return found
    times = dict(zip(np.array(columns)[far].tolist(), (asked / prior[columns])[far].tolist(), strict=True))
    sigma = prior.copy()
    for alike in _group_comparable_columns(found):
        largest = max((times[k] for k in alike if k in times), default=0.0)
        sigma[alike] = prior[alike] * max(1.0, WIDTH * largest)
    again = refit_under_source(found, replace(source, library_sigma=sigma))  # type: ignore[type-var]
    return found if again.problem.chi2 > problem.chi2 else again


def refit_under_source(found: SearchResult, source: Source) -> SearchResult:
    """The search with the same names, fitted with what another ``source`` says of them."""
    problem = under(replace(found.problem.settings, source=source), found.problem, found.columns)
    return replace(found, problem=problem, steps=found.extended_steps(problem, found.chosen))


def repeat_until_unchanged(
    once: Callable[[SearchResult], SearchResult], found: SearchResult, passes: int
) -> SearchResult:
    """The search after so many passes of ``once``, fewer where one returns what it was given."""
    for _ in range(passes):
        before, found = found, once(found)
        if found is before:
            break
    return found
