"""Amplitudes far beyond what is usual, fitted again under the size that the rows show: a prior would pull them towards zero.

The prior of an amplitude says how large it usually is, and keeps what the rows hardly show near zero while a search tries
one effect after another. Of one that was named, twenty times larger than usual, it took several standard deviations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linearized import refit

LARGER = 1.5  # times the prior deviation, from which an amplitude has a prior of its own size
PASSES = 2  # the first still finds it pulled


def widened(found: SearchResult) -> SearchResult:
    """The search with named amplitudes as likely as they came out, fitted again; itself where none is unusually large."""
    for _ in range(PASSES):
        before, found = found, _once(found)
        if found is before:
            break
    return found


def _once(found: SearchResult) -> SearchResult:
    problem, columns = found.problem, found.columns
    source = problem.settings.source
    size = np.abs(source.library(problem.values)[columns])
    far = size > LARGER * source.library_sigma[columns]
    if not np.any(far):
        return found
    sigma = source.library_sigma.copy()
    sigma[np.array(columns)[far]] = size[far]
    wider = replace(source, library_sigma=sigma)  # type: ignore[type-var]
    problem.resting()
    again = refit(replace(problem.settings, source=wider), problem.values, columns)
    return replace(found, problem=again, steps=found.stepped(again, found.chosen))
