"""The last fit as a version, and how sure each name is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from kilter_core.effects.physical import Separator
from kilter_core.gap.effect_search import SearchOutcome
from kilter_core.gap.evidence.control import control_document, controls
from kilter_core.gap.evidence.fits.intervals import amplitudes, seen_joints
from kilter_core.gap.evidence.guarded import Guard
from kilter_core.gap.evidence.halves import Halves, Sides, halves
from kilter_core.gap.evidence.held_out.adequacy import Adequacy, adequacy
from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator
from kilter_core.gap.evidence.held_out.practical_size import Misfit, floor_mm, misfit, moves_mm, outweighing
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit, unseen_fit
from kilter_core.gap.evidence.replication import Confirmation, Replication, replication
from kilter_core.gap.evidence.separators import REVERSALS, separating_evidence
from kilter_core.gap.evidence.similarity.aliases import Alias, find_aliases
from kilter_core.gap.evidence.similarity.smooth import local_bump_test
from kilter_core.gap.evidence.stability import inclusion
from kilter_core.gap.evidence.verdict import SURE, Evidence, Judged, judge, run_verdict
from kilter_core.gap.options import MEASURING, RESAMPLING, SHUFFLING
from kilter_core.gap.report.effect_curves import measured_range
from kilter_core.gap.report.stored import Stored, build_stored_version, refit_chosen, settled_search
from kilter_core.gap.search.forward_selection import SearchResult, chance
from kilter_core.gap.search.linear.complete_form import MissingDirection, missing_directions
from kilter_core.gap.search.linear.linearized import fit_rms
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.study import Study
from kilter_core.identify.comparison import Difference
from kilter_core.parameters import display_unit_and_scale

Aliases = Mapping[int, tuple[Alias, ...]]


def judge_effects(study: Study, fit: FitAssessment) -> tuple[tuple[Judged, ...], dict[str, Any]]:
    """Return every named effect with its evidence and verdict, what gains most first; and the negative control's document."""
    found, options, budget = fit.search.found, study.options, study.budget
    aliases = {k: find_aliases(found, k) for k in found.chosen}
    drafts = _draft_evidence(study, fit, aliases)

    def judge_evidence(evidence: Evidence) -> Judged:
        settled, library = fit.is_settled(evidence.moves_mm), fit.search.prepared.library
        level = judge(found, evidence, fit.adequacy, library, settled, bool(fit.lacking), drafts.values())
        return replace(level, measured=measured_range(found, level))

    shares = inclusion(
        found,
        {k: tuple(a.place for a in rivals) for k, rivals in aliases.items()},
        [k for k, evidence in drafts.items() if judge_evidence(evidence).verdict in SURE],
        options.resamples,
        options.seed,
        study.stage_progress(0.65, 0.85, "selecting again on resamples"),
        lambda: budget.over(RESAMPLING, "resamples of poses"),
    )
    shuffled = controls(
        found,
        list(drafts),
        options.permutations,
        options.seed,
        study.stage_progress(0.85, 0.95, "negative control"),
        lambda: budget.over(SHUFFLING, "shuffles of the negative control"),
    )
    tried = [replace(drafts[c.place], inclusion=shares.get(c.place), control=c) for c in shuffled]
    effects = sorted((judge_evidence(evidence) for evidence in tried), key=lambda j: -j.evidence.gain_mm)
    return tuple(effects), control_document(found, shuffled, options.permutations, options.seed)


def _draft_evidence(study: Study, fit: FitAssessment, aliases: Aliases) -> dict[int, Evidence]:
    """All evidence but that of resamples and shuffles, of what takes the most off the errors first.

    These take longest, and only matter where this lets a name rise. No verdict waits for profile intervals.
    """
    found, held, budget = fit.search.found, fit.version.held, study.budget
    moved, again = moves_mm(found), _replications(study, fit)
    own, sides = dict[int, Halves | None](), Sides(found, study.options.max_effects)
    # Only where something else is left is an effect asked to rise by itself.
    alone = {k for k in found.chosen if not fit.is_settled(moved[k]) and not fit.adequacy.too_large}
    for k in sorted(found.chosen, key=held.taken_off, reverse=True):
        late = k in alone and budget.over(MEASURING, "the halves of the campaign")
        own[k] = halves(sides, k, [a.place for a in aliases[k]]) if k in alone and not late else None
    sizes = amplitudes(
        found,
        study.stage_progress(0.6, 0.65, "profile intervals"),
        lambda: budget.over(MEASURING, "profile intervals"),
    )
    candidates = found.selector.scorer.candidates
    unit = display_unit_and_scale(found.problem.settings.source.unit)[1]
    out, left_mm = {}, fit_rms(found.problem) * unit
    for k, told in own.items():
        joints, seen = seen_joints(found, k)
        separated = separating_evidence(found, k)
        apart = any(e.separator is Separator.FRICTION and e.met for e in separated)  # then its twin is not a rival
        out[k] = Evidence(
            place=k,
            candidate=candidates[k],
            aliases=tuple(a for a in aliases[k] if not apart or a.candidate.id not in REVERSALS),
            inclusion=(1.0, 1.0),
            held_out=held.effect_gain(k),
            control=None,
            amplitudes=tuple(sizes[c] for c in candidates[k].columns),
            p_value=chance(found, k, study.options.alpha),
            gain_mm=held.taken_off(k) * unit,
            local_bump=local_bump_test(found, k, fit.search.prepared.visits.observations.q),
            unseen_poses=held.poses,
            seen_joints=joints,
            seen=seen,
            moves_mm=moved[k],
            replication=again.get(k),
            separated=separated,
            halves=told,
            untimed=told is None and k in alone and sides.able,
            left_mm=left_mm,
            borne=None if told is None or not told.lasts else outweighing(found, k, told.joints, fit.misfit),
        )
    return out


def _replications(study: Study, fit: FitAssessment) -> dict[int, Replication]:
    """What the confirmation says of every chosen candidate."""
    found, stored, rows = fit.search.found, fit.version.stored, study.confirmation
    if rows is None or not found.chosen:
        return {}
    heard = study.stage_progress(0.58, 0.6, "confirmation")
    seen = Confirmation.from_observations(
        stored.calibration, stored.posterior, rows, study.options, lambda fraction, _: heard(fraction)
    )
    candidates = found.selector.scorer.candidates
    guard = Guard.from_confirmation(found, study.start, stored.calibration, rows)
    told = {k: replication(seen, study.robot, rows, candidates[k], seen_joints(found, k)[0]) for k in found.chosen}
    return {k: replace(one, guarded=guard.effect(k)) for k, one in told.items()}


@dataclass(frozen=True)
class Version:
    """A fit, what is stored of it with its uncertainty, and how it predicts held-out rows."""

    found: SearchResult
    stored: Stored
    held: HoldoutEvaluator

    @staticmethod
    def from_search(study: Study, prepared: Prepared, found: SearchResult) -> Version:
        """Build the version of all that a search named."""
        stored = build_stored_version(found, study.start, prepared.rows, study.options, study.validation)
        return Version(found, stored, HoldoutEvaluator(found, prepared, study.validation, stored.posterior))


@dataclass(frozen=True)
class FitAssessment:
    """How the last fit agrees with the rows searched (``adequacy``, ``misfit``) and with rows held out (``unseen``).

    ``version`` has all that was named; ``lacking`` are rotations that the robot's description lacks and that do as well.
    """

    search: SearchOutcome
    version: Version
    adequacy: Adequacy
    misfit: Misfit
    unseen: UnseenFit | None
    lacking: tuple[MissingDirection, ...]

    def is_settled(self, moves_mm: float) -> bool:
        """Whether nothing is left of which an effect that moves the tool so far may be a part; held-out rows may refute it."""
        refuted = self.unseen is not None and self.unseen.refutes_model
        return not refuted and (bool(self.adequacy.adequate) or self.misfit.is_negligible_for_effect(moves_mm))

    def verdict(self, effects: tuple[Judged, ...]) -> str:
        """Verdict of the run, by the rows searched and by those held out."""
        verdict = run_verdict(effects, self.adequacy, self.misfit)
        return verdict if self.unseen is None else self.unseen.verdict(verdict)


def assess_fit(study: Study, search: SearchOutcome) -> FitAssessment:
    """Assess the last fit of a search."""
    found, prepared = search.found, search.prepared
    rows = prepared.visits.observations
    fit = adequacy(found.problem, prepared.visits.condition, found.columns)
    version = Version.from_search(study, prepared, found)
    left = misfit(found, fit, rows, study.options)
    unseen = unseen_fit(version.held, floor_mm(rows, study.options))
    return FitAssessment(search, version, fit, left, unseen, missing_directions(prepared.problem, found.columns))


def settle_version(study: Study, fit: FitAssessment, effects: Sequence[Judged]) -> Version:
    """Return the version without steps and drifts that are not settled, and what it corrects without what is not the arm's.

    Where rows that no choice saw err more with all of it than with the geometry alone, beyond chance, it is that geometry.
    """
    version, settled = fit.version, settled_search(fit.search.found, effects)
    if settled is not version.found:
        version = Version.from_search(study, fit.search.prepared, settled)
    if version.found.chosen and _is_worse_than_geometry(study, version):
        version = Version.from_search(study, fit.search.prepared, refit_chosen(version.found, ()))
    elsewhere = [j.evidence.candidate.id for j in effects if not j.of_arm]
    return replace(version, stored=version.stored.without_correction(elsewhere))


def _is_worse_than_geometry(study: Study, version: Version) -> bool:
    """Whether held-out rows, or a confirmation, are predicted worse by the version than by the geometry alone."""
    if version.held.poses and Difference.from_paired_errors(*reversed(version.held.by_pose())).worse:
        return True
    if study.confirmation is None:
        return False
    calibration = version.stored.calibration
    told = Guard.from_confirmation(version.found, study.start, calibration, study.confirmation).geometry()
    return told is not None and told.worse
