"""The search: which effects the rows name under the noise that these names leave, and the last fit with them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.effects import Effect
from kilter_core.errors import Finding
from kilter_core.gap.evidence.fits.final_fit import by_rows, jacobian_prior_covariance
from kilter_core.gap.evidence.fits.intervals import amplitude_significance, are_all_significant
from kilter_core.gap.evidence.held_out.when import refine_event_positions
from kilter_core.gap.evidence.separators import compare_with_friction
from kilter_core.gap.evidence.similarity.testability import Testability, testability, through_loads, to_search
from kilter_core.gap.options import MEASURING, SEARCHING, Budget, OutOfTimeError
from kilter_core.gap.search.candidates import FAMILY, JOINT, Candidate, Library, Untestable, with_testable
from kilter_core.gap.search.events import refit_with_updated_noise, under
from kilter_core.gap.search.forward_selection import (
    SearchResult,
    finalize,
    or_geometry_alone,
    search,
    update_event_times,
    update_selector,
)
from kilter_core.gap.search.linear.linearized import LinearizedProblem, estimate_linear_parameters, refit
from kilter_core.gap.search.linear.settings import library_parameters
from kilter_core.gap.search.prepare import Prepared, blur_load_signs
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.sources.source import Source
from kilter_core.gap.study import Study
from kilter_core.types import Bools, Floats

TAKEN_OVER = 0.2  # share of the variance of an amplitude that would vanish with a joint that it imitates


# Families cut down to the joints that show them: a version stores nothing of joints the rows have not seen.
# A family is named by all of its joints together, so those that carry no load or hardly move get an amplitude too,
# which is noise and nothing else: a compliance of 200 times the truth, or one below zero, at the last joint of an
# arm.


@dataclass(frozen=True)
class Unseen:
    """Joints (from 0) at which the rows do not show a family that was named for ``joints``."""

    candidate: Candidate
    joints: tuple[int, ...]

    def untestable(self) -> Untestable:
        """What is to be measured there."""
        c = self.candidate
        reason = "It is named at other joints; these rows do not show it here: it stays nominal, and nothing is stored."
        return Untestable(c.id, self.joints, reason, c.effects[0].remedy, "poses that show these joints")

    def finding(self) -> Finding:
        """The same as a finding of the search."""
        said = {"effect": self.candidate.id, "joints": [j + 1 for j in self.joints]}
        return Finding("unseen_stays_nominal", said, {"remedy": self.candidate.effects[0].remedy})


def seen_only(found: SearchResult) -> tuple[SearchResult, tuple[Unseen, ...]]:
    """The search with every family at the joints that show it, fitted again; and what was left out.

    Joints go one by one, the least certain first, as long as nothing that differs from zero goes with them: two joints that
    the poses hardly tell apart are each uncertain, and one of them is not. Where one would take over what the other does,
    both stay, each as uncertain as it is.
    """
    out = []
    for n, place in enumerate(found.chosen):
        candidate = found.selector.scorer.candidates[place]
        if candidate.level != FAMILY:
            continue
        left = _shown_members(found, candidate)
        gone = tuple(j for e, _ in _members(found, candidate) if e not in [m[0] for m in left] for j in e.joints or ())
        if gone:
            out.append(Unseen(candidate, gone))
            found = _with_members(found, n, left)
    return found, tuple(out)


Member = tuple[Effect, tuple[int, ...]]


def _members(found: SearchResult, candidate: Candidate) -> Iterator[Member]:
    """Effects of a family with their columns."""
    start, robot = 0, found.problem.settings.source.model.robot
    for effect in candidate.effects:
        end = start + len(effect.parameters(robot))
        yield effect, candidate.columns[start:end]
        start = end


def _shown_members(found: SearchResult, candidate: Candidate) -> list[Member]:
    left, gone = list(_members(found, candidate)), list[int]()
    others = [k for k in found.columns if k not in candidate.columns]
    members = len(left)
    while len(left) > 1:
        columns = sorted({*others, *_columns(left)})
        apart = [
            n for n, (_, own) in enumerate(left) if _nominal(found, own) or not _taken_over(found, columns, own, left)
        ]
        if not apart:
            break
        chances = {
            n: 1.0 if _nominal(found, left[n][1]) else amplitude_significance(found, columns, left[n][1])[0]
            for n in apart
        }
        worst = max(apart, key=chances.__getitem__)
        # Each at 95 % by itself, one family of seven in three kept a joint that has nothing.
        together = [amplitude_significance(found, found.columns, [*gone, *left[worst][1]])[0]]
        sure = are_all_significant(list(chances.values()), members) or are_all_significant(
            together, members - len(left) + 1
        )
        if chances[worst] < 1.0 and sure:
            break
        gone += left.pop(worst)[1]
    return left


def _taken_over(found: SearchResult, columns: Sequence[int], own: Sequence[int], members: Sequence[Member]) -> bool:
    """Whether members that stay would take over what one does: without it one of them would be told much too surely.

    Its amount would then be presumed to be zero, which no data say, and theirs would be wrong by what it is.
    """
    covariance = estimate_linear_parameters(found.problem, columns)[1]
    at = {k: n for n, k in enumerate(columns)}
    mine, theirs = [at[k] for k in own], [at[k] for k in _columns(members) if k not in own]
    shared = covariance[np.ix_(theirs, mine)]
    known = np.sum(shared @ np.linalg.pinv(covariance[np.ix_(mine, mine)], hermitian=True) * shared, axis=1)
    return bool(np.any(known > TAKEN_OVER * np.diag(covariance)[theirs]))


def _nominal(found: SearchResult, own: Sequence[int]) -> bool:
    """Whether a fit within the physical range leaves amplitudes at zero: a compliance that came out below it."""
    return not np.any(found.problem.settings.source.library(found.problem.values)[list(own)])


def _columns(members: Sequence[Member]) -> tuple[int, ...]:
    return tuple(k for _, own in members for k in own)


def _with_members(found: SearchResult, n: int, left: list[Member]) -> SearchResult:
    """The search whose ``n``-th name has these members only, fitted again."""
    scorer, place = found.selector.scorer, found.chosen[n]
    candidates, columns = list(scorer.candidates), _columns(left)
    own = candidates[place]
    alone = [
        k for k, c in enumerate(candidates) if c.level == JOINT and c.id == own.id and set(c.columns) == set(columns)
    ]
    if len(left) == 1 and alone:
        place = alone[0]
    else:
        joints = tuple(j for e, _ in left for j in e.joints or ())
        candidates[place] = replace(own, columns=columns, joints=joints, effects=tuple(e for e, _ in left), part=True)
    chosen = (*found.chosen[:n], place, *found.chosen[n + 1 :])
    selector = replace(found.selector, scorer=scorer.from_candidates(candidates, scorer.absolute, scorer.freedom))
    problem = refit(found.problem.settings, found.problem.values, selector.columns(chosen))
    cut = replace(found, selector=selector, chosen=chosen, problem=problem)
    return replace(cut, steps=cut.extended_steps(problem, chosen))


def name_by_friction(found: SearchResult) -> SearchResult:
    """Return the search with each reversal under the name that torques single out, fitted again."""
    candidates, chosen = found.selector.scorer.candidates, list(found.chosen)
    for n, place in enumerate(found.chosen):
        member, *_ = compare_with_friction(found, place) or (candidates[place].id,)
        wanted = (member, candidates[place].joints)
        chosen[n] = (
            place
            if member == candidates[place].id
            else next((k for k, c in enumerate(candidates) if (c.id, c.joints) == wanted), place)
        )
    if tuple(chosen) == found.chosen:
        return found
    problem = refit(found.problem.settings, found.problem.values, found.selector.columns(chosen))
    return replace(found, chosen=tuple(chosen), problem=problem, steps=found.extended_steps(problem, tuple(chosen)))


SEARCHES = 2  # the second where the noise of the first showed that more could be tested
SECOND = "a second search under the noise of the first"
ROUNDS = 3  # of names judged by the noise and noise judged by the names
AGAIN = "noise and wrong readings as the names leave them"

CHANGED = 0.05  # of a blur: less moves no sign that matters
SIGN_PASSES = 3  # narrower signs show the masses better, which narrows them again
LARGER = 1.5  # times the prior deviation, from which an amplitude has a prior of its own size
TOLD = 3.0  # of its standard deviations by the rows alone, beside those of all other names, from which they tell it
WIDTH = 2.0  # of what the rows ask for: a prior that takes less than a tenth of a standard deviation of what is told
PRIOR_PASSES = 2  # the first still finds it pulled


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
    found = refine_event_positions(refit_with_wider_priors(name_by_friction(found)), study.validation)
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


# The last fit, made again until it changes no more: with signs of loads, then with priors, as the data leave them.
# The prior of an amplitude says how large it usually is, and keeps what the rows hardly show near zero while a search
# tries one effect after another. Of one that was named, twenty times larger than usual, it took several standard
# deviations, and where the rows know it less well than the prior does, nearly all. Shapes without a cause keep their
# priors, and so do amplitudes that the rows do not tell from zero by themselves: without them, curves of a joint that
# imitate one another and the geometry ran to the ends of their ranges, and the error of a real arm from 0.4 to 2.7
# mm.


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
