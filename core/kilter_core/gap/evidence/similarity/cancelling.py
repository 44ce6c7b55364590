"""Effects that each move the arm several times the whole gap and cancel: what is known is their sum, not its parts."""

from __future__ import annotations

import numpy as np

from kilter_core.gap.evidence.similarity.similarity import Alias, correlation
from kilter_core.gap.evidence.similarity.smooth import EVEN
from kilter_core.gap.search.forward_selection import SearchResult

SEVERAL = 2.0  # times the whole gap, after geometry, that each of two effects must move the arm


def cancelling_members(search: SearchResult, place: int) -> tuple[Alias, ...]:
    """The chosen effects that a chosen one cancels against, under the name of their sum; none where it does not cancel.

    Compared after geometry: an effect that geometry undoes in part is no larger than what is left of it.
    """
    problem, selector = search.problem, search.selector
    columns = search.columns
    fitted = dict(zip(columns, problem.gram.solve(columns), strict=True))
    candidates = selector.scorer.candidates

    def contribution_norm(*places: int) -> float:
        own = selector.columns(places)
        beta = np.array([fitted[k] for k in own])
        return float(np.sqrt(max(beta @ problem.A[np.ix_(own, own)] @ beta, 0.0)))

    gap = contribution_norm(*search.chosen)
    if contribution_norm(place) < SEVERAL * gap:
        return ()
    against = [
        k
        for k in search.chosen
        if k != place
        and contribution_norm(k) > SEVERAL * gap
        and contribution_norm(place, k) < max(contribution_norm(place), contribution_norm(k)) / SEVERAL
    ]
    if not against:
        return ()
    own = candidates[place].columns
    names = " and ".join(candidates[k].label for k in sorted((place, *against)))
    name = f"sum of {names}"
    return tuple(
        Alias(k, candidates[k], 0.0, correlation(problem.A, own, candidates[k].columns), EVEN, name) for k in against
    )
