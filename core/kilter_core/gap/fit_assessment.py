"""The last fit as a version: its uncertainty, what it leaves of the rows searched, and what of those that no choice saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kilter_core.gap.effect_search import SearchOutcome
from kilter_core.gap.evidence.guarded import Guard
from kilter_core.gap.evidence.held_out.adequacy import Adequacy, adequacy
from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator
from kilter_core.gap.evidence.held_out.practical_size import Misfit, floor_mm, misfit
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit, unseen_fit
from kilter_core.gap.evidence.verdict import Judged, run_verdict
from kilter_core.gap.report.stored import Stored, build_stored_version, refit_chosen, settled_search
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.complete_form import MissingDirection, missing_directions
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.study import Study
from kilter_core.identify.comparison import Difference


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
