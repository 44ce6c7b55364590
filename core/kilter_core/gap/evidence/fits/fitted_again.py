"""A search whose last fit is made again under other settings, until these change no more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.re_evaluation import under
from kilter_core.gap.search.sources.source import Source


def fitted_again(found: SearchResult, source: Source) -> SearchResult:
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
