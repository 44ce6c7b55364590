"""What a search came to, and what it warns of: the arm, the rows, the last fit, the version, and poses to measure next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.errors import Finding, FindingDocument, Sentences
from kilter_core.gap.effect_verdicts import FitAssessment, Version
from kilter_core.gap.evidence.guarded import Guard
from kilter_core.gap.evidence.held_out.practical_size import moves_mm
from kilter_core.gap.evidence.held_out.when import event_findings, events, not_said_by
from kilter_core.gap.evidence.verdict import CONTRADICTED, Judged
from kilter_core.gap.report.localization import Place
from kilter_core.gap.report.separation import ToldApart
from kilter_core.gap.search.linear.complete_form import incomplete_warnings
from kilter_core.gap.search.linear.linearized import fit_rms
from kilter_core.gap.study import Study
from kilter_core.identify.comparison import (
    CONFIRM,
    WORSE_THAN_GEOMETRY,
    PoseErrors,
    elsewhere,
    grown,
    worse_warning,
)
from kilter_core.identify.identifiability import far_from_stated
from kilter_core.identify.plausibility.believable import another_arm
from kilter_core.identify.report import large_residual
from kilter_core.measurement import Measurement
from kilter_core.parameters import degrees, display_unit_and_scale

LARGE_DEG = 2.0  # left between two encoders of a joint: worth a warning

Remark = Finding | FindingDocument

CALLED = {"base_step": "The station (base or instrument)", "tool_step": "The tool, its marker or its nest"}
SEEN = {
    "base_step": "The base, or the camera or board in the room",
    "tool_step": "The tool, or the camera or board on the flange",
}
SESSION = "Give the rows from there on a session of their own: "
REMEDIES = {
    "base_step": f"{SESSION}with --refit base every session has a base of its own.",
    "tool_step": f"{SESSION}with --refit tool every session has a tool of its own.",
}
OF_THE_ARM = "It is the arm's from there on: a correction takes the last."


@dataclass(frozen=True)
class Outcome:
    """What each step of a search found; ``version`` is the one to store, ``fit.version`` that with all that was named."""

    study: Study
    where: tuple[Place, ...]
    fit: FitAssessment
    effects: tuple[Judged, ...]
    control: dict[str, Any]
    version: Version
    next_poses: list[dict[str, Any]]
    told_apart: ToldApart | None


def _report_missing_loads(outcome: Outcome) -> Iterator[Remark]:
    """Say which effects were not looked for because nothing is known to load the joints."""
    prepared = outcome.fit.search.prepared
    loaded = list(dict.fromkeys(e.id for e in prepared.library.effects if "moments" in e.needs))
    if loaded and not np.any(prepared.problem.settings.source.batch.wrench):
        yield Finding("no_load", {"effects": loaded})


def _warn_of_large_residual(outcome: Outcome) -> Iterator[Remark]:
    """Say when much is left after everything that was named: a fact about the model, no verdict about the rows."""
    problem = outcome.fit.search.found.problem
    size, source = fit_rms(problem), problem.settings.source
    if source.observes_tool:
        points = source.model.predict(source.batch, source.model_values(problem.values)).position
        yield from large_residual(size, points)
    elif degrees(size) > LARGE_DEG:
        yield FindingDocument.make("large_residual", f"{degrees(size):.2f} deg are left between the encoders.")


def _compare_with_geometry(outcome: Outcome) -> Iterator[Remark]:
    """Warn when held-out poses are predicted worse than by the geometry alone, within chance: beyond it is not stored."""
    found, before_after = outcome.version.found, outcome.version.held.by_pose()
    if found.chosen and (told := grown(*before_after)) is not None:
        unit = "deg" if found.problem.settings.source.unit == "rad" else "mm"
        yield worse_warning(WORSE_THAN_GEOMETRY, "the geometry alone", told, False, unit)


def _compare_on_confirmation(outcome: Outcome) -> Iterator[Remark]:
    """Warn when the confirmation is predicted worse than by something simpler."""
    study, version = outcome.study, outcome.version
    if study.confirmation is not None:
        calibration = version.stored.calibration
        guard = Guard.from_confirmation(version.found, study.start, calibration, study.confirmation)
        yield from guard.warnings(version.stored.registered)


def _compare_on_validation(outcome: Outcome) -> Iterator[Remark]:
    """Warn when held-out poses are predicted worse than by base and tool alone, or stand in other frames."""
    rows, stored = outcome.study.validation, outcome.version.stored
    calibration, plain = stored.calibration, stored.registered
    if rows is not None and plain is not None:
        unseen = Measurement.from_observations(rows, calibration.marker_points, held=True)
        stages = {"registration_only": plain, "identified": calibration}
        yield from PoseErrors.from_calibrations(stages, unseen).warnings()
        yield from elsewhere(calibration, unseen, CONFIRM)


def _report_amplitudes_at_ends(outcome: Outcome) -> Iterator[Remark]:
    """Say it of every amplitude that is at an end of its range, other than nominal."""
    calibration = outcome.version.stored.calibration
    model, start = calibration.model, calibration.model.n_geometric
    for p, value in zip(model.parameters[start:], calibration.values[start:], strict=True):
        ends = (e for e in (p.lower, p.upper) if np.isfinite(e) and np.isclose(value, e, rtol=1e-9, atol=0.0))
        end = next(ends, None)
        if end is not None and end != p.value:
            unit, scale = display_unit_and_scale(p.unit)
            yield Finding("at_end_of_range", {"parameter": p.name, "value": end * scale, "unit": unit})


def _report_unsettled_effects(outcome: Outcome) -> Iterator[Remark]:
    """Say which effects the version does without although nothing contradicts each by itself, and what would settle them."""
    stored = outcome.version.found.chosen
    out = [j for j in outcome.effects if j.evidence.place not in stored and j.verdict != CONTRADICTED]
    if out:
        names = list(dict.fromkeys(j.display_name for j in out))
        yield Finding("not_settled", {"effects": [j.evidence.candidate.label for j in out]}, {"names": names})


def _report_unplanned_poses(outcome: Outcome) -> Iterator[Remark]:
    """Say why no poses are proposed where contacts decide which poses the arm can take."""
    source = outcome.fit.search.prepared.problem.settings.source
    if outcome.effects and outcome.study.options.next_poses and not source.observes_places:
        yield Finding("no_next_poses", {})


def _report_events(outcome: Outcome) -> Iterator[Remark]:
    """Say when something happened once during the campaign."""
    study, found = outcome.study, outcome.fit.search.found
    doubtful = {j.evidence.place for j in outcome.effects if not j.certain}
    seen = events(found, study.every, moves_mm(found))
    return event_findings(found, seen, doubtful, study.by_views is not None, study.remarks)


# After the fit, in the order in which they are told.
AFTER: tuple[Callable[[Outcome], Iterable[Remark]], ...] = (
    lambda outcome: incomplete_warnings(outcome.fit.lacking),
    lambda outcome: another_arm(outcome.version.stored.calibration),
    lambda outcome: outcome.fit.search.prepared.warnings,
    lambda outcome: outcome.fit.adequacy.warnings(),
    _report_missing_loads,
    _warn_of_large_residual,
    _compare_with_geometry,
    _compare_on_confirmation,
    _compare_on_validation,
    lambda outcome: far_from_stated(outcome.version.stored.load_model()),
    _report_amplitudes_at_ends,
    _report_unsettled_effects,
    lambda outcome: outcome.version.stored.similar_pose_warnings(),
    lambda outcome: () if outcome.told_apart is None else outcome.told_apart.warnings(),
    _report_unplanned_poses,
    _report_events,
    lambda outcome: [unseen.finding() for unseen in outcome.fit.search.unseen],
)


def outcome_warnings(outcome: Outcome) -> tuple[FindingDocument, ...]:
    """Return all warnings as documents: of the time that was left, after the fit, and before it unless named by the search."""
    study, after = outcome.study, tuple(documents(one for check in AFTER for one in check(outcome)))
    return (*study.budget.warnings(), *after, *not_said_by(after, study.remarks))


def _moved_once(said: Mapping[str, Any]) -> str:
    who = (SEEN if said["by_views"] else CALLED).get(said["effect"], f"The zero of joint {said['joint']}")
    verb = "may have moved" if said["likely"] else "moved"
    low, high = said["rows_95"]
    sure = "" if low == high == said["row"] else f" (95 %: the first row after it is {low} to {high})"
    return (
        f"{who} {verb} between rows {said['before']} and {said['row']}{sure}, by {said['moved_mm']:.3g} mm "
        f"(95 %: within {said['u95_mm']:.1g} mm) at the tool on average{_rotation_phrase(said)}. {_remedy(said)}"
    )


def _rotation_phrase(said: Mapping[str, Any]) -> str:
    if not said["moves_frame"]:
        return ""
    if said["rotated_deg"] is None:
        return " (one point of it was measured, which shows no rotation)"
    return f" and {said['rotated_deg']:.2g} deg (within {said['u95_deg']:.1g} deg)"


def _remedy(said: Mapping[str, Any]) -> str:
    if not said["moves_frame"]:
        return OF_THE_ARM
    if not said["by_views"]:
        return REMEDIES[said["effect"]]
    named = f"If {said['part']} {said['name']} moved, give it" if "part" in said else "Give that camera or board"
    return f"{named} another name from there on: each place is then fitted by itself."


def _unseen_stays_nominal(said: Mapping[str, Any]) -> str:
    where = ("joint " if len(said["joints"]) == 1 else "joints ") + ", ".join(map(str, said["joints"]))
    remedy = f"{said['remedy'][:1].lower()}{said['remedy'][1:]}"
    return (
        f"{said['effect']} is not shown at {where}: it stays nominal there, and the version stores nothing of it. "
        f"To find it there: {remedy}"
    )


def _no_load(said: Mapping[str, Any]) -> str:
    return (
        f"{', '.join(said['effects'])} were not looked for: they follow load moments, and neither link masses nor a payload "
        "are known. Give the robot's links mass_kg and com_mm, or the rows payload_kg, and search again."
    )


def _no_next_poses(said: Mapping[str, Any]) -> str:
    return (
        "No poses are proposed: the contact decides which poses the arm can take. To make a name surer, hold the "
        "ball in more placements, with joint angles and orientations that differ from those measured."
    )


def _at_end_of_range(said: Mapping[str, Any]) -> str:
    size = f"{said['value']:.3g}" if said["unit"] == "1" else f"{said['value']:.3g} {said['unit']}"
    return (
        f"{said['parameter']} would come out beyond what is physical and is held at {size}: something else is in it. "
        "Check units, masses and payloads, and search again with `effects` that leave it out."
    )


def _not_settled(said: Mapping[str, Any]) -> str:
    return (
        f"The version leaves out what is not settled: {', '.join(said['names'])}. To settle it, measure more poses, revisit "
        "some at other times, or measure all in random order."
    )


SENTENCES: Sentences = {
    "moved_once": _moved_once,
    "unseen_stays_nominal": _unseen_stays_nominal,
    "no_load": _no_load,
    "no_next_poses": _no_next_poses,
    "at_end_of_range": _at_end_of_range,
    "not_settled": _not_settled,
}


def documents(findings: Iterable[Finding | FindingDocument]) -> Iterator[FindingDocument]:
    """Return findings of a search as they are stored and sent; documents of others as they are."""
    return (one.to_document(SENTENCES) if isinstance(one, Finding) else one for one in findings)
