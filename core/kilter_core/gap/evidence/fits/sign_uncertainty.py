"""Signs of loads as uncertain as the data leave the masses: the search began with what was stated of them."""

from __future__ import annotations

import numpy as np

from kilter_core.gap.evidence.fits.final_fit import jacobian_prior_covariance
from kilter_core.gap.evidence.fits.fitted_again import fitted_again, repeat_until_unchanged
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.masses import blur_load_signs

CHANGED = 0.05  # of a blur: less moves no sign that matters
PASSES = 3  # narrower signs show the masses better, which narrows them again


def narrow_sign_uncertainty(found: SearchResult) -> SearchResult:
    """The search with the blur of its signs made again from the posterior of the masses, and re-fitted; itself if unchanged.

    While it searches the blur is that of the priors, because what is not named yet would narrow
    nothing, or the wrong masses.
    """
    return repeat_until_unchanged(_once, found, PASSES)


def _once(found: SearchResult) -> SearchResult:
    problem = found.problem
    source = problem.settings.source
    if not found.chosen or source.batch.blur is None:
        return found
    loads = np.flatnonzero(source.of_loads)
    after = blur_load_signs(source, problem.values, jacobian_prior_covariance(found)[2][np.ix_(loads, loads)])
    before = source.batch.blur
    if after.batch.blur is None or np.all(np.abs(after.batch.blur - before) <= CHANGED * before):
        return found
    return fitted_again(found, after)
