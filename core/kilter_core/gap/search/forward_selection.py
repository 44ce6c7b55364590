"""The search: enter the best, re-fit, swap and drop; and afterwards no name that chance could have given.

The search judged each entry before the last re-fit. Here everything is judged again at the final fit, with the null
distribution the report quotes; and an empirical term that a physical one could replace at the same price is replaced.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.options import SEARCHING, Budget, GapOptions, OutOfTimeError
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.events import place_events, refit_with_updated_noise, under
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, fit_rms, ignore_step, nearest, refit
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.scan import Null, Scorer, null_distribution, residual_given
from kilter_core.gap.search.select import MARGIN, SMALLEST_GAIN, Selector
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


# Position against orientation: what moves a joint moves both, so an effect fitted to both must fit each.
#
# On a robot arm under a laser tracker with a probe, orientations showed what looked like backlash of the wrist; the
# positions, which the same backlash must move, said the opposite. Such a name is an artefact of the instrument, not
# of the arm.

APART = 0.001  # chance of calling a true effect contradicted
POSE = 6  # scalars of a full pose: position, then orientation
SEEN = 1e-9


def has_conflicting_amplitudes(search: SearchResult, place: int) -> bool:
    """Whether position and orientation give a chosen effect different amplitudes, and it makes one of them worse."""
    problem = search.problem
    size = problem.settings.whitener.shape[-1]
    if size != POSE or problem.settings.source.tool_numbers != POSE or not problem.settings.source.observes_tool:
        return False
    selector = search.selector
    rest = selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    W = problem.projected_columns(list(selector.scorer.candidates[place].columns))
    X = W - basis @ (basis.T @ W)
    r = residual_given(problem, rest)
    amount = np.asarray(np.linalg.lstsq(X, r, rcond=None)[0], dtype=np.float64)
    turned = np.arange(len(r)) % size >= 3
    worse = [_gain(X[part], r[part], amount) < 0.0 for part in (~turned, turned)]
    if not any(worse):
        return False
    # D r is the difference of the two estimates; the noise left of r is that off the basis.
    D = np.zeros((X.shape[1], len(r)))
    D[:, ~turned], D[:, turned] = np.linalg.pinv(X[~turned]), -np.linalg.pinv(X[turned])
    covariance = D @ D.T - (D @ basis) @ (D @ basis).T
    w, V = np.linalg.eigh(covariance * selector.variance(problem.gram, search.chosen))
    keep = w > SEEN * max(float(w[-1]), 1e-300)
    apart = float(np.sum((V[:, keep].T @ (D @ r)) ** 2 / w[keep]))
    return bool(chi2.sf(apart, int(keep.sum())) < APART)


def _gain(X: Floats, r: Floats, amount: Floats) -> float:
    moved = X @ amount
    return float(2.0 * moved @ r - moved @ moved)


def finalize(found: SearchResult, alpha: float) -> SearchResult:
    """Drop and replace until every member is significant at the final fit; each change is followed by a re-fit."""
    seen = {frozenset(found.chosen)}
    while found.chosen:
        wrong = [k for k in found.chosen if has_conflicting_amplitudes(found, k)][:1]
        after = tuple(k for k in found.chosen if k not in wrong) if wrong else _without_chance(found, alpha)
        if after == found.chosen:
            after = _with_better_names(found, seen)
        if after == found.chosen:
            return found
        seen.add(frozenset(after))
        found.problem.resting()
        problem = refit(found.problem.settings, found.problem.values, found.selector.columns(after))
        found = replace(found, problem=problem, chosen=after, steps=found.extended_steps(problem, after))
    return found


def or_geometry_alone(found: SearchResult, geometry: LinearizedProblem) -> SearchResult:
    """The search if what it found leaves a smaller error than the ``geometry`` alone; else nothing is named."""
    better = found.problem.chi2 <= geometry.chi2 and fit_rms(found.problem) <= fit_rms(geometry)
    if found.chosen and better:
        return found
    steps = (found.steps[0],) if not found.chosen else found.extended_steps(geometry, ())
    return replace(found, problem=geometry, chosen=(), steps=steps)


def chance(found: SearchResult, place: int, alpha: float) -> float:
    """Family-wise p-value of a chosen candidate given the others, at the final fit.

    Where the linear statistic does not reach ``alpha``, a re-fit without the candidate decides: what it leaves more is
    the likelihood ratio. An amplitude times an uncertain load is not linear, and an effect far from zero whose
    uncertainty is that of the loads was called chance although nothing else explained the rows.
    """
    scorer = found.selector.scorer
    rest = found.selector.columns([k for k in found.chosen if k != place])
    gram = found.problem.gram
    scores = scorer.scores(gram.condition_on_columns(rest))
    tests = len(scorer.candidates)
    p = found.null.family_wise(float(scores.p[place]), tests)
    if p <= alpha:
        return p
    without = refit(found.problem.settings, found.problem.values, rest)
    ratio = scorer.tail_of_ratio(
        place, int(scores.d[place]), without.chi2, found.problem.chi2, gram.nu - gram.rank(rest)
    )
    return min(p, found.null.family_wise(ratio, tests))


def rejected_candidates(found: SearchResult) -> list[dict[str, Any]]:
    """Rows {id, joints, explains, p_value} of the candidates that were not named, the least likely by chance first.

    ``explains`` is the share of the squared residuals of the final fit that the candidate would take away with geometry
    fitted beside it (reduction S of the score test); ``p_value`` is family-wise, as that of a name. Candidates that the
    named ones or geometry imitate whole are left out: they have no score.
    """
    scorer, gram = found.selector.scorer, found.problem.gram.condition_on_columns(found.columns)
    scores = scorer.scores(gram)
    rows = [
        {
            **candidate.id_and_joints(),
            "explains": min(1.0, float(scores.S[k]) / gram.yy) if gram.yy > 0.0 else 0.0,
            "p_value": found.null.family_wise(float(scores.p[k]), len(scorer.candidates)),
        }
        for k, candidate in enumerate(scorer.candidates)
        if k not in found.chosen and scores.d[k] > 0
    ]
    return sorted(rows, key=lambda row: (row["p_value"], -row["explains"]))


def _without_chance(found: SearchResult, alpha: float) -> tuple[int, ...]:
    p = {k: chance(found, k, alpha) for k in found.chosen}
    worst = max(p, key=lambda k: p[k])
    return found.chosen if p[worst] <= alpha else tuple(k for k in found.chosen if k != worst)


def _with_better_names(found: SearchResult, seen: set[frozenset[int]]) -> tuple[int, ...]:
    """The set with one empirical member replaced by the best physical one within the margin, where there is one, or a
    physical member by another of its class at the same joints, where that does better at the final fit.
    """
    selector, gram = found.selector, found.problem.gram
    candidates = selector.scorer.candidates
    for place in found.chosen:
        allowed = MARGIN if candidates[place].empirical else -SMALLEST_GAIN
        rest = tuple(k for k in found.chosen if k != place)
        taken = set(selector.columns(rest))
        scores = selector.scorer.scores(gram.condition_on_columns(selector.columns(rest)))
        value = scores.S / selector.variance(gram, found.chosen) - scores.d * np.log(selector.rows)
        value -= selector.scorer.paid
        for k in np.argsort(-value, kind="stable"):
            rival = candidates[int(k)]
            if value[place] - value[k] > allowed:
                break
            after = (*rest, int(k))
            fits = not rival.empirical and not taken & set(rival.columns)
            fits = fits and (candidates[place].empirical or _are_of_a_class(candidates[place], rival))
            if fits and scores.d[k] and frozenset(after) not in seen and selector.plausible(gram, after, int(k)):
                return after
    return found.chosen


def _are_of_a_class(one: Candidate, other: Candidate) -> bool:
    return one.joints == other.joints and one.effects[0].physical.id == other.effects[0].physical.id
