"""The search: enter the best, re-fit everything, swap and drop, until what is left is no better than noise (E5)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kilter_core.gap.budget import SEARCHING, Budget, OutOfTimeError
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.events import place_events
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, ignore_step, nearest, refit
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.re_evaluation import refit_with_updated_noise, under
from kilter_core.gap.search.scan import Null, Scorer, null_distribution
from kilter_core.gap.search.select import Selector
from kilter_core.types import Floats, Progress

MORE = "effects beyond those named"


@dataclass(frozen=True)
class Step:
    """One refit of the search: the set after it (labels), and rms of the residual in whitened units."""

    names: tuple[str, ...]
    chi2_per_freedom: float


@dataclass(frozen=True)
class SearchResult:
    """Where the search ended: the linearised problem at the final fit, the chosen candidates, the limits it used, its steps.

    ``noise`` is that of a coordinate at its beginning, in units of which its steps are; None where it stayed the same.
    ``strict`` is the limit of a negative control, which has the effect among its noise; ``critical`` when None.
    """

    problem: LinearizedProblem
    selector: Selector
    chosen: tuple[int, ...]
    null: Null
    critical: float
    steps: tuple[Step, ...]
    noise: float | None = None
    strict: float | None = None

    @property
    def columns(self) -> list[int]:
        """Library columns of the chosen set."""
        return self.selector.columns(self.chosen)

    @property
    def has_paired_entry(self) -> bool:
        """Whether two names entered at once."""
        return any(len(set(after.names) - set(before.names)) > 1 for before, after in itertools.pairwise(self.steps))

    def extended_steps(self, problem: LinearizedProblem, chosen: tuple[int, ...]) -> tuple[Step, ...]:
        """The steps with one more."""
        step = describe_step(problem, self.selector, chosen)
        return (*self.steps, step if self.noise is None else _in_units_of(self.noise, problem, step))


def search(
    settings: ProblemSettings,
    problem: LinearizedProblem,
    scorer: Scorer,
    limits: Floats,
    options: GapOptions,
    progress: Progress,
    budget: Budget | None = None,
) -> SearchResult:
    """Run from the geometry-only ``problem``; every change of the set is followed by a nonlinear re-fit of everything.

    ``limits (Q,)`` are the largest plausible amplitudes of the library's parameters, SI. A shape without a cause that
    entered early can keep out the causes that together explain more: if one is left, causes are searched alone as well.
    """
    selector = Selector(scorer, problem.rows, limits * problem.size)
    budget = budget or Budget()
    found = _forward_selection(problem, selector, limits, options, progress, budget)
    if not selector.shapes(found.chosen) or budget.over(SEARCHING, "causes instead of shapes without one"):
        return found
    causes = _forward_selection(problem, selector.causes, limits, options, progress, budget)
    causes = replace(causes, problem=under(found.problem.settings, causes.problem, causes.columns))
    return replace(causes, selector=found.selector) if _explains_more(causes, found) else found


def _forward_selection(
    problem: LinearizedProblem,
    selector: Selector,
    limits: Floats,
    options: GapOptions,
    progress: Progress,
    budget: Budget,
) -> SearchResult:
    """Climb from the geometry; after every re-fit noise and outliers are judged again by what is named by then."""
    chosen: tuple[int, ...] = ()
    begin = problem
    scorer = selector.scorer
    first: Null | None = None
    steps = [describe_step(problem, selector, chosen)]
    seen = {frozenset(chosen)}
    for round_ in itertools.count():
        if round_ >= selector.rounds(chosen, options.max_effects):
            break
        progress(min(0.9, round_ / 6.0), f"scan {round_ + 1}: {len(scorer.candidates)} candidates")
        problem, selector = update_event_times(problem, selector, chosen, limits)
        scorer = selector.scorer
        null = null_distribution(problem, selector.scorer, selector.columns(chosen), options.bootstraps, options.seed)
        first = first or null
        critical = null.critical(options.alpha)
        ticking = replace(selector, tick=budget.tick(SEARCHING, MORE)) if round_ else selector
        try:
            after = ticking.better(problem.gram, chosen, critical, options.max_effects, seen)
        except OutOfTimeError:
            break
        if set(after) == set(chosen) or budget.over(SEARCHING, MORE):
            break
        seen.add(frozenset(after))
        now = (
            min(0.9, (round_ + 0.5) / 6.0),
            "re-fitting with " + ", ".join(scorer.candidates[m].label for m in after),
        )
        tick = partial(budget.ending(progress, SEARCHING, MORE), *now)
        problem.resting()
        try:
            columns = selector.columns(after)
            start = nearest(problem.settings, (problem.values, begin.values), columns)
            other = refit(problem.settings, start, columns, tick)
        except OutOfTimeError:
            break
        if worse(selector, (other, after), (problem, chosen)):
            continue  # the set does not do what the linearised problem promised
        still = problem.size == 0.0
        problem, chosen = _renewed_in_time(other, selector.columns(after), tick), after
        # A column that was zero may move something by now: an error of the payload does beside a compliance.
        if problem is not other or np.any((problem.size > 0.0) & still):
            selector = update_selector(problem, selector, limits)
        del other  # of thousands of poses it would fill the memory beside the next
        steps.append(_in_units_of(begin.settings.noise.coordinate, problem, describe_step(problem, selector, chosen)))
    assert first is not None
    noise = begin.settings.noise.coordinate
    critical, strict = first.critical(options.alpha), first.strict(options.alpha)
    return SearchResult(problem, selector, chosen, first, critical, tuple(steps), noise, strict)


def _renewed_in_time(problem: LinearizedProblem, columns: list[int], tick: Tick) -> LinearizedProblem:
    """The problem with noise and outliers judged again; itself where there was no time for it."""
    try:
        return refit_with_updated_noise(problem, columns, tick, at_last=False)
    except OutOfTimeError:
        return problem


def update_event_times(
    problem: LinearizedProblem, selector: Selector, chosen: tuple[int, ...], limits: Floats, tick: Tick = ignore_step
) -> tuple[LinearizedProblem, Selector]:
    """The search with every event at the row where it takes most, given what is chosen, and fitted again if one is."""
    candidates = selector.scorer.candidates
    after, made = place_events(problem, candidates, chosen)
    if made == candidates:
        return after, selector
    if any(made[k] != candidates[k] for k in chosen):
        after = refit(after.settings, after.values, selector.columns(chosen), tick)
    selector = replace(selector, scorer=replace(selector.scorer, candidates=made))
    return after, update_selector(after, selector, limits)


def update_selector(problem: LinearizedProblem, selector: Selector, limits: Floats) -> Selector:
    """The same search at another fit, whose noise may be another and known better or worse."""
    scorer = selector.scorer.knowing(problem.settings.noise)
    return replace(selector, scorer=scorer, rows=problem.rows, limits=limits * problem.size)


def worse(
    selector: Selector, one: tuple[LinearizedProblem, tuple[int, ...]], other: tuple[LinearizedProblem, tuple[int, ...]]
) -> bool:
    """Whether a set, at its own fit, explains less than another: more of it leaves more, or all of it at its price."""
    (problem, chosen), (before, known) = one, other
    if set(chosen) >= set(known):
        return problem.chi2 > before.chi2
    variance = min(selector.variance(w.gram, c) for w, c in (one, other))
    price = [selector.price(c, [w.gram.rank(selector.columns(c))]) for w, c in (one, other)]
    return problem.chi2 / variance + price[0] > before.chi2 / variance + price[1] + selector.slack(chosen)


def _explains_more(one: SearchResult, other: SearchResult) -> bool:
    """Whether what one search leaves, with the price of its names, is less than the other's, at the smaller noise."""
    variance = min(h.selector.variance(h.problem.gram, h.chosen) for h in (one, other))
    cost = [
        (h.problem.gram.yy - h.problem.gram.reduction(h.columns)) / variance
        + h.selector.price(h.chosen, [h.problem.gram.rank(h.columns)])
        for h in (one, other)
    ]
    return bool(one.chosen) and cost[0] < cost[1]


def _in_units_of(noise: float, problem: LinearizedProblem, step: Step) -> Step:
    """A step in the noise of the first: noise that was re-estimated would make every step leave as much."""
    ratio = problem.settings.noise.coordinate / noise
    return replace(step, chi2_per_freedom=step.chi2_per_freedom * ratio**2)


def describe_step(problem: LinearizedProblem, selector: Selector, chosen: tuple[int, ...]) -> Step:
    """Describe a set at the fit that includes it."""
    left = problem.gram.condition_on_columns(selector.columns(chosen))
    return Step(tuple(selector.scorer.candidates[k].label for k in chosen), left.yy / max(left.nu, 1.0))
