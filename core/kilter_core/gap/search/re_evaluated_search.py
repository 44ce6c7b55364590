"""A search judged again under the noise that its own names leave: a drift that is named is no longer noise.

A name that follows the clock or the temperature explains a part of what repeats differ by. Judged by the noise from before
it, everything seems too good to be true, or too small to be seen.
"""

from __future__ import annotations

from dataclasses import replace

from kilter_core.gap.budget import MEASURING, Budget, OutOfTimeError
from kilter_core.gap.search.finalize import finalize
from kilter_core.gap.search.forward_selection import SearchResult, update_event_times, update_selector
from kilter_core.gap.search.re_evaluation import refit_with_updated_noise
from kilter_core.types import Floats

AGAIN = "noise and wrong readings as the names leave them"
ROUNDS = 3  # of names judged by the noise and noise judged by the names


def re_evaluate_search(found: SearchResult, alpha: float, limits: Floats, budget: Budget | None = None) -> SearchResult:
    """Settle the names and renew noise and outliers in turn, until neither changes. ``limits (Q,)`` as of a search.

    The names are settled in any case: one that chance could have given is none. Once its share of the ``budget`` is over,
    noise and outliers stay as they are.
    """
    tick = (budget or Budget()).tick(MEASURING, AGAIN)
    for round_ in range(ROUNDS):
        found = finalize(found, alpha)
        try:
            at, selector = update_event_times(found.problem, found.selector, found.chosen, limits, tick)
            problem = refit_with_updated_noise(at, found.columns, tick, at_last=not round_)
        except OutOfTimeError:
            return found
        if problem is found.problem:
            return replace(found, selector=selector)
        selector = update_selector(problem, selector, limits)
        found = replace(found, problem=problem, selector=selector, steps=found.extended_steps(problem, found.chosen))
    return finalize(found, alpha)
