"""A gap search from rows to report: where the model is wrong, what is missing, how sure that is, what to measure next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS
from kilter_core.gap.budget import MEASURING, PLANNING, RESAMPLING, SEARCHING, SHUFFLING, Budget
from kilter_core.gap.evidence.control import control_document, controls
from kilter_core.gap.evidence.fits.intervals import Amplitude, amplitudes, seen_joints
from kilter_core.gap.evidence.fits.sign_uncertainty import narrow_sign_uncertainty
from kilter_core.gap.evidence.fits.widened import refit_with_wider_priors
from kilter_core.gap.evidence.guarded import Guard
from kilter_core.gap.evidence.halves import Halves, Sides, halves
from kilter_core.gap.evidence.held_out.adequacy import Adequacy, adequacy
from kilter_core.gap.evidence.held_out.by_kind import by_kind
from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator, gap_document, noise_document
from kilter_core.gap.evidence.held_out.holding_out import held_out, split_held_out_rows
from kilter_core.gap.evidence.held_out.practical_size import Misfit, floor_mm, misfit, moves_mm, outweighing
from kilter_core.gap.evidence.held_out.unseen import seen_only
from kilter_core.gap.evidence.held_out.unseen_fit import unseen_fit
from kilter_core.gap.evidence.held_out.when import event_findings, events, not_said_by, refine_event_positions
from kilter_core.gap.evidence.local_bump import local_bump_test
from kilter_core.gap.evidence.rejected import rejected_candidates
from kilter_core.gap.evidence.replication import Confirmation, Replication, refuse_unfit, replication
from kilter_core.gap.evidence.separators import separating_evidence
from kilter_core.gap.evidence.similarity.aliases import SAME, Alias, find_aliases
from kilter_core.gap.evidence.similarity.testability import (
    Testability,
    alias_matrix,
    smallest_rows,
    testability,
    through_loads,
    to_search,
    untestable,
)
from kilter_core.gap.evidence.stability import inclusion
from kilter_core.gap.evidence.verdict import SURE, Evidence, Judged, is_settled, judge, run_verdict, sentence
from kilter_core.gap.options import GapOptions
from kilter_core.gap.report.aside import agreement_sentence, poses_again, rows_aside
from kilter_core.gap.report.doubtful_poses import version_doubts
from kilter_core.gap.report.effect_curves import effect_curves, measured_range
from kilter_core.gap.report.figures import figures
from kilter_core.gap.report.localization import Place, localize, remains
from kilter_core.gap.report.next_poses import proposal_rows, separate
from kilter_core.gap.report.report import GapReport, Remains
from kilter_core.gap.report.search_warnings import (
    held_at_ends,
    left_out_findings,
    size_warnings,
    unloaded_findings,
    unplanned_findings,
)
from kilter_core.gap.report.sentences import documents
from kilter_core.gap.report.stored import Stored, build_stored_version, settled_search
from kilter_core.gap.report.told_apart import Proposed, ToldApart, are_never_separable, assess_separation
from kilter_core.gap.search.candidates import Candidate, Library, with_testable
from kilter_core.gap.search.events import with_row_numbers
from kilter_core.gap.search.finalize import chance, or_geometry_alone
from kilter_core.gap.search.forward_selection import SearchResult, search
from kilter_core.gap.search.linear.complete_form import incomplete_sentence, incomplete_warnings, missing_directions
from kilter_core.gap.search.linear.in_space import fit_rms
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.search.re_evaluated_search import re_evaluate_search
from kilter_core.gap.search.requested import joints_by_effect
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.start_model import beginning
from kilter_core.identify.comparison.model_comparison import (
    WORSE_THAN_GEOMETRY,
    Difference,
    PoseErrors,
    grown,
    worse_warning,
)
from kilter_core.identify.comparison.other_setups import CONFIRM, elsewhere
from kilter_core.identify.identifiable.load_model import far_from_stated
from kilter_core.identify.plausibility.another_arm import another_arm
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.identify.rows.read_tilt import as_inputs
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.identify.views.planned_views import PlannedViews
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.clock import clock_warnings
from kilter_core.parameters import display_unit_and_scale, metres
from kilter_core.types import Progress, unheard

SEARCHES = 2  # the second where the noise of the first showed that more could be tested
AGAIN = "a second search under the noise of the first"


def find_gap(
    robot: Robot,
    observations: Observations,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    validation: Observations | float | None = None,
    progress: Progress | None = None,
    confirmation: Observations | None = None,
) -> GapReport:
    """Find where the model is wrong, name what is missing, add it, and show the gap shrink on poses never used.

    ``start`` is the model to begin with (nominal geometry without one); its effects are kept and re-fitted.
    ``validation`` is other observations, or a fraction of the poses to hold out before anything is chosen; None holds
    out a quarter where there are 60 poses or more, and 0 none: then one pose is left out at a time, and nothing can be
    confirmed. ``confirmation`` is a campaign of another day or set-up: base and tool are fitted to it, nothing is chosen
    there, and what it shows with the same amplitude is replicated. ``progress(fraction, stage)`` may raise to cancel.

    Raises:
        TooFewPosesError: the geometry alone needs more poses, or base and tool of the confirmation. ObservationError:
        nothing measured, ``foreign_observations``, ``rows_shared``. OptionError: options that do not fit, a start of another.

    """
    options, progress = options or GapOptions(), progress or unheard
    begin, budget = beginning(robot, start, observations, options), Budget(options.budget_s)
    named = [EFFECTS[name] for name in joints_by_effect(options.effects)]
    given = as_inputs(named, begin, observations, validation, confirmation)
    (observations, validation, confirmation), by_views, odd = seen_poses(begin, *given)
    if confirmation is not None:
        for rows in (observations, validation):
            if isinstance(rows, Observations):
                refuse_unfit(robot, rows, confirmation)
        refuse_mixed_up(begin, confirmation)
    observations = with_row_numbers(observations)
    remarks = (*refuse_mixed_up(begin, observations), *clock_warnings(observations), *odd)
    every, share = observations, validation
    observations, validation = split_held_out_rows(observations, validation, options.seed)
    prepared = prepare_data(begin, observations, options, _map_progress(progress, 0.0, 0.15), budget)
    run = _Run(robot, begin, prepared, options, validation, confirmation, progress, every, budget, by_views, remarks)
    report = run.report()
    if not isinstance(share, Observations):
        report = report.with_row_numbers(*held_out(every, share, options.seed))
    return replace(report, warnings=(*budget.warnings(), *report.warnings, *not_said_by(report.warnings, remarks)))


def _map_progress(progress: Progress, low: float, high: float) -> Progress:
    """Map a stage's own fraction into its share of the whole."""
    return lambda fraction, stage: progress(low + (high - low) * min(1.0, fraction), stage)


def _stage(progress: Progress, low: float, high: float, words: str) -> Callable[[float], None]:
    return lambda fraction: _map_progress(progress, low, high)(fraction, words)


@dataclass(frozen=True)
class _Run:
    robot: Robot
    begin: Calibration
    prepared: Prepared
    options: GapOptions
    validation: Observations | None
    confirmation: Observations | None
    progress: Progress
    every: Observations  # searched and held out, in the order of the file
    budget: Budget
    by_views: PlannedViews | None
    remarks: tuple[dict[str, Any], ...]  # of the fit before the search

    def report(self) -> GapReport:
        prepared, problem = self.prepared, self.prepared.problem
        self.progress(0.15, "where the model is wrong")
        places = localize(problem, prepared.visits.observations, self.options.seed, prepared.moving)
        judged = testability(problem, prepared.library)
        for _ in range(SEARCHES):
            candidates = with_testable(prepared.library, to_search(judged, prepared.library))
            found = self._search_candidates(prepared.problem, candidates)
            found.problem.resting()
            prepared = prepared.update_noise_and_outliers(found.problem)
            # Without repeats the noise shrinks as effects enter, and what could not show in it may show now.
            again = testability(prepared.problem, prepared.library)
            more, judged = bool(np.any(again.able & ~judged.able)), again
            if not more or not found.chosen or self.budget.over(SEARCHING, AGAIN):
                break
        for rests in (problem, prepared.problem):
            rests.resting()
        found, unseen = seen_only(narrow_sign_uncertainty(found))
        judged = through_loads(judged, testability(found.problem, prepared.library), prepared.library)
        prepared = prepared.update_noise_and_outliers(found.problem)
        found = or_geometry_alone(found, prepared.problem)
        prepared.problem.resting()
        found = refine_event_positions(refit_with_wider_priors(found), self.validation)
        report = replace(self, prepared=prepared)._build_report(found, places, judged, candidates)
        return report.with_unseen(unseen) if found.chosen else report

    def _search_candidates(self, problem: LinearizedProblem, candidates: tuple[Candidate, ...]) -> SearchResult:
        noise = problem.settings.noise
        scorer = Scorer.from_candidates(
            candidates, problem.settings.trusted, noise.freedom if noise.absolute else np.inf
        )
        limits = np.array([max(abs(p.lower), abs(p.upper)) for p in self.prepared.library.parameters])
        found = search(
            problem.settings, problem, scorer, limits, self.options, _map_progress(self.progress, 0.2, 0.5), self.budget
        )
        return re_evaluate_search(found, self.options.alpha, limits, self.budget)

    def _build_report(
        self, found: SearchResult, places: tuple[Place, ...], judged: Testability, candidates: tuple[Candidate, ...]
    ) -> GapReport:
        """The report on what was found; the preparation is that with the noise and outliers of the last fit."""
        prepared, problem = self.prepared, self.prepared.problem
        rows = prepared.visits.observations
        fit = adequacy(found.problem, prepared.visits.condition, found.columns)
        kept = build_stored_version(found, self.begin, prepared.rows, self.options, self.validation)
        left = misfit(found, fit, rows, self.options)
        held = HoldoutEvaluator(found, prepared, self.validation, kept.posterior)
        unseen = unseen_fit(held, floor_mm(rows, self.options))
        whole = partial(is_settled, fit, left, unseen is not None and unseen.refutes_model)
        lacking = missing_directions(problem, found.columns)
        effects, control = self._judge_effects(found, fit, left, kept, held, whole, bool(lacking))
        of_version, kept, seen = self._settled_version(found, effects, kept, held)
        verdict = run_verdict(effects, fit, left)
        verdict = verdict if unseen is None else unseen.verdict(verdict)
        rest = Remains(left, None if fit.adequate else remains(found.problem, found.columns, rows, self.options.seed))
        judging = held.report()
        gap = gap_document(prepared, found, judging)
        self.progress(0.95, "next poses and pictures")
        poses, told = self._next_poses(found, effects)
        poses = [*(poses_again(prepared, self.validation, held.set_aside) if self.options.next_poses else ()), *poses]
        return GapReport(
            stored=kept.with_doubts(version_doubts(held, verdict, unseen)),
            verdict=verdict,
            effects=effects,
            unseen=unseen,
            remains=rest,
            sentence=sentence(verdict, effects, fit, left, rest.words)
            + ("" if unseen is None else unseen.sentence())
            + incomplete_sentence(lacking)
            + agreement_sentence(prepared, self.validation, held.set_aside),
            where=places,
            gap=gap,
            measurements=by_kind(prepared, found, held, judging),
            adequacy=fit,
            misfit=left,
            predictive=judging.predictive,
            not_testable=untestable(prepared.library, judged, problem, rows),
            smallest_detectable=smallest_rows(prepared.library, judged),
            refused=rejected_candidates(found),
            next_poses=poses,
            told_apart=told,
            negative_control=control,
            alias_matrix=alias_matrix(problem, candidates, found.chosen),
            noise=noise_document(found.problem.settings),
            warnings=(
                *incomplete_warnings(lacking),
                *self._fit_warnings(found, fit, kept),
                *self._worse(of_version, seen, kept),
                *self._version_warnings(kept, effects),
                *self._plan_warnings(found, effects, told),
            ),
            figures=figures(found, rows, gap, held),
            effect_curves=effect_curves(found, effects),
            library=prepared.library,
            **self._aside(kept, held, gap),
        )

    def _settled_version(
        self, found: SearchResult, effects: tuple[Judged, ...], kept: Stored, held: HoldoutEvaluator
    ) -> tuple[SearchResult, Stored, HoldoutEvaluator]:
        """The search without steps and drifts that are not settled, its version, and what held-out rows say of it."""
        settled = settled_search(found, effects)
        if settled is not found:
            kept = build_stored_version(settled, self.begin, self.prepared.rows, self.options, self.validation)
            held = HoldoutEvaluator(settled, self.prepared, self.validation, kept.posterior)
        return settled, kept.without_correction([j.evidence.candidate.id for j in effects if not j.of_arm]), held

    def _fit_warnings(self, found: SearchResult, fit: Adequacy, kept: Stored) -> Iterator[dict[str, Any]]:
        """Warnings about the arm, the rows and the last fit."""
        yield from another_arm(kept.calibration)
        yield from self.prepared.warnings
        yield from fit.warnings()
        yield from documents(unloaded_findings(self.prepared))
        yield from size_warnings(found)

    def _version_warnings(self, kept: Stored, effects: tuple[Judged, ...]) -> Iterator[dict[str, Any]]:
        """Warnings about the version that is stored."""
        yield from far_from_stated(kept.load_model())
        yield from documents(held_at_ends(kept.calibration))
        yield from documents(left_out_findings(effects))
        yield from kept.similar_pose_warnings()

    def _plan_warnings(
        self, found: SearchResult, effects: tuple[Judged, ...], told: ToldApart | None
    ) -> Iterator[dict[str, Any]]:
        """Warnings about poses that could not be planned, and about events during the campaign."""
        yield from () if told is None else told.warnings()
        if effects and self.options.next_poses:
            yield from documents(unplanned_findings(self.prepared.problem))
        doubtful = {j.evidence.place for j in effects if not j.certain}
        seen = events(found, self.every, moves_mm(found))
        yield from documents(event_findings(found, seen, doubtful, self.by_views is not None, self.remarks))

    def _aside(self, kept: Stored, held: HoldoutEvaluator, gap: dict[str, Any]) -> dict[str, Any]:
        """The rows that were let go, of those searched and of those held out."""
        sigma, spikes = metres(gap["noise_mm"] or 0.0), held.set_aside
        out = {"set_aside": tuple(rows_aside(kept.calibration, self.prepared.given, self.prepared.outlying, sigma))}
        if self.validation is not None:
            out["held_aside"] = tuple(rows_aside(kept.calibration, self.validation, spikes, sigma))
        return {**out, "spikes": spikes}

    def _judge_effects(
        self,
        found: SearchResult,
        fit: Adequacy,
        left: Misfit,
        kept: Stored,
        held: HoldoutEvaluator,
        whole: Callable[[float], bool],
        lacking: bool,
    ) -> tuple[tuple[Judged, ...], dict[str, Any]]:
        """Evidence for every chosen candidate, and the gates; ``whole(moves_mm)`` as :func:`is_settled`."""
        aliases = {k: find_aliases(found, k) for k in found.chosen}
        classes = {k: tuple(a.place for a in rivals) for k, rivals in aliases.items()}
        drafts = self._drafts(found, fit, left, kept, held, whole, aliases)

        def judge_evidence(evidence: Evidence) -> Judged:
            settled = whole(evidence.moves_mm)
            level = judge(found, evidence, fit, self.prepared.library, settled, lacking, drafts.values())
            return replace(level, measured=measured_range(found, level))

        rising = [k for k, evidence in drafts.items() if judge_evidence(evidence).verdict in SURE]
        shares = inclusion(
            found,
            classes,
            rising,
            self.options.resamples,
            self.options.seed,
            _stage(self.progress, 0.65, 0.85, "selecting again on resamples"),
            lambda: self.budget.over(RESAMPLING, "resamples of poses"),
        )
        shuffled = controls(
            found,
            list(drafts),
            self.options.permutations,
            self.options.seed,
            _stage(self.progress, 0.85, 0.95, "negative control"),
            lambda: self.budget.over(SHUFFLING, "shuffles of the negative control"),
        )
        tried = [replace(drafts[c.place], inclusion=shares.get(c.place), control=c) for c in shuffled]
        out = sorted((judge_evidence(evidence) for evidence in tried), key=lambda j: -j.evidence.gain_mm)
        return tuple(out), control_document(found, shuffled, self.options.permutations, self.options.seed)

    def _drafts(
        self,
        found: SearchResult,
        fit: Adequacy,
        left: Misfit,
        kept: Stored,
        held: HoldoutEvaluator,
        whole: Callable[[float], bool],
        aliases: dict[int, tuple[Alias, ...]],
    ) -> dict[int, Evidence]:
        """All evidence but that of resamples and shuffles, of what takes the most off the errors first.

        These take longest, and only matter where this lets a name rise. No verdict waits for profile intervals.
        """
        moved, again = moves_mm(found), self._replications(found, kept)
        own, sides = dict[int, Halves | None](), Sides(found, self.options.max_effects)
        # Only where something else is left is an effect asked to rise by itself.
        alone = {k for k in found.chosen if not whole(moved[k]) and not fit.too_large}
        for k in sorted(found.chosen, key=held.taken_off, reverse=True):
            late = k in alone and self.budget.over(MEASURING, "the halves of the campaign")
            own[k] = halves(sides, k, [a.place for a in aliases[k]]) if k in alone and not late else None
        sizes = amplitudes(
            found,
            _stage(self.progress, 0.6, 0.65, "profile intervals"),
            lambda: self.budget.over(MEASURING, "profile intervals"),
        )
        out, left_mm = {}, fit_rms(found.problem) * display_unit_and_scale(found.problem.settings.source.unit)[1]
        for k, told in own.items():
            borne = None if told is None or not told.lasts else outweighing(found, k, told.joints, left)
            evidence, late = (
                self._evidence(found, k, aliases[k], sizes, held),
                told is None and k in alone and sides.able,
            )
            out[k] = replace(
                evidence,
                moves_mm=moved[k],
                replication=again.get(k),
                halves=told,
                untimed=late,
                left_mm=left_mm,
                borne=borne,
            )
        return out

    def _replications(self, found: SearchResult, kept: Stored) -> dict[int, Replication]:
        """What the confirmation says of every chosen candidate."""
        if self.confirmation is None or not found.chosen:
            return {}
        part = _map_progress(self.progress, 0.58, 0.6)
        rows, robot = self.confirmation, self.robot
        seen = Confirmation.from_observations(
            kept.calibration, kept.posterior, rows, self.options, lambda f, s: part(f, "confirmation")
        )
        candidates = found.selector.scorer.candidates
        guard = Guard.from_confirmation(found, self.begin, kept.calibration, rows)
        told = {k: replication(seen, robot, rows, candidates[k], seen_joints(found, k)[0]) for k in found.chosen}
        return {k: replace(one, guarded=guard.effect(k)) for k, one in told.items()}

    def _evidence(
        self,
        found: SearchResult,
        place: int,
        rivals: tuple[Alias, ...],
        sizes: dict[int, Amplitude],
        held: HoldoutEvaluator,
    ) -> Evidence:
        candidate = found.selector.scorer.candidates[place]
        unit = display_unit_and_scale(found.problem.settings.source.unit)[1]
        joints, any_ = seen_joints(found, place)
        return Evidence(
            place,
            candidate,
            rivals,
            (1.0, 1.0),
            held.effect_gain(place),
            None,
            tuple(sizes[c] for c in candidate.columns),
            chance(found, place, self.options.alpha),
            held.taken_off(place) * unit,
            local_bump_test(found, place, self.prepared.visits.observations.q),
            held.poses,
            joints,
            any_,
            separated=separating_evidence(found, place),
        )

    def _worse(self, found: SearchResult, held: HoldoutEvaluator, kept: Stored) -> Iterator[dict[str, Any]]:
        """Warn when held-out poses are predicted worse than by geometry, or by base and tool, alone."""
        unit = "deg" if found.problem.settings.source.unit == "rad" else "mm"
        before_after = held.by_pose()
        if found.chosen and (told := grown(*before_after)) is not None:
            certain = Difference.from_paired_errors(*reversed(before_after)).worse
            yield worse_warning(WORSE_THAN_GEOMETRY, "the geometry alone", told, certain, unit)
        if self.confirmation is not None:
            yield from Guard.from_confirmation(found, self.begin, kept.calibration, self.confirmation).warnings(
                kept.registered
            )
        if self.validation is None or kept.registered is None:
            return
        calibration, plain = kept.calibration, kept.registered
        unseen = Measurement.from_observations(self.validation, calibration.marker_points, held=True)
        yield from PoseErrors.from_calibrations(
            {"registration_only": plain, "identified": calibration}, unseen
        ).warnings()
        yield from elsewhere(calibration, unseen, CONFIRM)

    def _next_poses(self, found: SearchResult, effects: tuple[Judged, ...]) -> Proposed:
        """For the least certain effect: poses that separate it from its nearest rival, or sharpen it."""
        if not effects or self.budget.over(PLANNING, "poses to measure next"):
            return [], None
        open_ = [
            (
                j,
                [
                    a
                    for a in j.alias_set
                    if a.correlation < SAME
                    and not a.member
                    and not are_never_separable(j.evidence.candidate, a.candidate, self.robot)
                ],
            )
            for j in effects
        ]
        asked = next(((j, a) for j, a in open_ if a), None)
        weak = [(j, list[Alias]()) for j in effects if j.verdict not in SURE]
        if not (asked or weak):
            return [], None
        j, rivals = asked or weak[0]
        target, rival = j.evidence.candidate, rivals[0].candidate if rivals else None
        others = [k for k in found.columns if k not in target.columns]
        values, rows = np.array([a.value for a in j.evidence.amplitudes]), self.prepared.visits.observations
        asked_for = (self.options.next_poses, self.options.seed, None, self.by_views)
        proposals = separate(found.problem, rows, target, [rival] if rival else [], others, values, *asked_for)
        names = target.label, rival.label if rival else "geometry"
        return proposal_rows(proposals, names, self.robot), assess_separation(
            proposals, target, rival, rows, self.robot
        )


__all__ = ["GapReport", "Library", "Testability", "find_gap"]
