"""The search: which effects the rows name under the noise that these names leave, and the last fit with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.gap.budget import MEASURING, SEARCHING, Budget, OutOfTimeError
from kilter_core.gap.evidence.fits.last_refits import narrow_sign_uncertainty, refit_with_wider_priors
from kilter_core.gap.evidence.held_out.unseen import Unseen, seen_only
from kilter_core.gap.evidence.held_out.when import refine_event_positions
from kilter_core.gap.evidence.similarity.testability import Testability, testability, through_loads, to_search
from kilter_core.gap.search.candidates import Candidate, Library, with_testable
from kilter_core.gap.search.finalize import finalize, or_geometry_alone
from kilter_core.gap.search.forward_selection import SearchResult, search, update_event_times, update_selector
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.search.re_evaluation import refit_with_updated_noise
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.study import Study
from kilter_core.types import Floats

SEARCHES = 2  # the second where the noise of the first showed that more could be tested
SECOND = "a second search under the noise of the first"
ROUNDS = 3  # of names judged by the noise and noise judged by the names
AGAIN = "noise and wrong readings as the names leave them"


@dataclass(frozen=True)
class SearchOutcome:
    """What the rows name: the last fit, ``found``, and the preparation with the noise and outliers that it leaves.

    ``candidates`` were searched; ``judged`` says which columns of the library could be tested; families that were named
    stay nominal at the joints of ``unseen``.
    """

    prepared: Prepared
    found: SearchResult
    judged: Testability
    candidates: tuple[Candidate, ...]
    unseen: tuple[Unseen, ...]


def search_effects(study: Study, prepared: Prepared) -> SearchOutcome:
    """Search for effects from the fitted geometry, and fit the named ones as a version will hold them."""
    problem, library = prepared.problem, prepared.library
    judged = testability(problem, library)
    for _ in range(SEARCHES):
        candidates = with_testable(library, to_search(judged, library))
        found = _search_candidates(study, prepared.problem, library, candidates)
        found.problem.resting()
        prepared = prepared.update_noise_and_outliers(found.problem)
        # Without repeats the noise shrinks as effects enter, and what could not show in it may show now.
        again = testability(prepared.problem, library)
        more, judged = bool(np.any(again.able & ~judged.able)), again
        if not more or not found.chosen or study.budget.over(SEARCHING, SECOND):
            break
    for rests in (problem, prepared.problem):
        rests.resting()
    found, unseen = seen_only(narrow_sign_uncertainty(found))
    judged = through_loads(judged, testability(found.problem, library), library)
    prepared = prepared.update_noise_and_outliers(found.problem)
    found = or_geometry_alone(found, prepared.problem)
    prepared.problem.resting()
    found = refine_event_positions(refit_with_wider_priors(found), study.validation)
    return SearchOutcome(prepared, found, judged, candidates, unseen if found.chosen else ())


def _search_candidates(
    study: Study, problem: LinearizedProblem, library: Library, candidates: tuple[Candidate, ...]
) -> SearchResult:
    settings, options, budget = problem.settings, study.options, study.budget
    freedom = settings.noise.freedom if settings.noise.absolute else np.inf
    scorer = Scorer.from_candidates(candidates, settings.trusted, freedom)
    limits = np.array([max(abs(p.lower), abs(p.upper)) for p in library.parameters])
    found = search(settings, problem, scorer, limits, options, study.progress_within(0.2, 0.5), budget)
    return re_evaluate_search(found, options.alpha, limits, budget)


def re_evaluate_search(found: SearchResult, alpha: float, limits: Floats, budget: Budget) -> SearchResult:
    """Settle the names and renew noise and outliers in turn, until neither changes. ``limits (Q,)`` as of a search.

    A name that follows the clock or the temperature explains a part of what repeats differ by. Judged by the noise from
    before it, everything seems too good to be true, or too small to be seen. The names are settled in any case: one that
    chance could have given is none. Once its share of the ``budget`` is over, noise and outliers stay as they are.
    """
    tick = budget.tick(MEASURING, AGAIN)
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
