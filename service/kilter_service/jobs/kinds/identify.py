"""Job kind ``identify``: observations into a new parameter version."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import FindingDocument, ObservationError, OptionError
from kilter_core.observations import Observations, refuse_shared_rows
from kilter_core.types import run_sequentially
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.contract.fits import NullDirection, metrics_with_earlier_names
from kilter_service.contract.jobs.check import Identifiability, UnknownParameter
from kilter_service.contract.jobs.identify import IDENTIFY, IdentifyOptions
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_identify, core_model, core_motion
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.budgets import add_to_metrics
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Lack, Progress, VersionContent
from kilter_service.jobs.plotly_figures.identify import identify_figures, uncertainty_figure
from kilter_service.jobs.setups import FRAMES, LAID_AGAIN, Setups, by_campaign, to_json_types
from kilter_service.jobs.torque_inputs import are_logs, fit_torques, refuse_effects_of_torques

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.identify import Folds, Identification, IdentificationCheck, SheetOrder
    from kilter_core.observations import Observations

    Again = Callable[[str, Observations], Identification | None]


NOT_OF_THE_CORE = {"start", "limits", "sheet_order", "masses_from"}

OPTION, GIVEN = "sheet_order", "given"


def check(options: IdentifyOptions) -> None:
    """Refuse options that do not go together.

    Raises:
        OptionError: a method without what another option needs, effects at a level without them, ...

    """
    if options.masses_from is not None and options.masses == "as_stated":
        raise OptionError(
            'masses "as_stated" takes them from the description, and masses_from from torques: give one of them.',
            option="masses_from",
        )
    core = _core(options)
    replace(core, effects=tuple(core_motion.split_effects(core.effects)[1])).make_effects()


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Identify the robot from all campaigns together; of logs of torques bodies, friction and the effects asked for."""
    if are_logs(job):
        return fit_torques(job, progress)
    options = _core(job.options)
    refuse_effects_of_torques(options.effects)
    setups = Setups(options.refit, job.devices)
    named = _campaigns_with_validation(job)
    remarks = doubts(job.robot, named, job.devices, job.options.sheet_order)
    train, validation = _rows(job, setups)
    each = job.each or run_sequentially
    found = core_identify.identify(
        job.robot, train, validation, options, job.start, progress, _prior(job), each, job.fleet
    )
    report = found.to_document()
    remarks += bar_lengths(found, job.robot, named, lambda name, rows: _refit(job, name, rows))
    report |= {f"{which}_refitted": setups.describe_refitted_frames(report[f"{which}_refitted"]) for which in FRAMES}
    apart = validation if isinstance(validation, Observations) else None
    held = tuple(job.validation) if isinstance(job.validation, dict) else ()
    add_to_metrics(report["metrics"], found, train, apart, job.instruments, tuple(job.campaigns), held)
    report["metrics"] = metrics_with_earlier_names(report["metrics"])
    counts = {name: len(rows) for name, rows in job.campaigns.items()}
    report["set_aside"] = by_campaign(report["set_aside"], counts)
    report["warnings"] += [*setups.warnings(report), *remarks]
    covariance = found.predictive.to_document()
    content = VersionContent(
        found.calibration.to_document(), report, covariance, job.options.limits or CorrectionLimits()
    )
    drawn = identify_figures(found, report, job) | uncertainty_figure(found, train, options.seed)
    return JobOutput({**report, "figures": to_json_types(drawn)}, content)


def _refit(job: JobInput, campaign: str, rows: Observations) -> Identification | None:
    """The same fit with other rows of a campaign; None where the campaign was not fitted."""
    if campaign not in job.campaigns:
        return None
    other = replace(job, campaigns={**job.campaigns, campaign: rows})
    train, validation = _rows(other, Setups(job.options.refit, job.devices))
    held = validation if isinstance(validation, float) else None  # the same rows are fitted
    return core_identify.identify(
        job.robot, train, held, _core(job.options), job.start, None, _prior(job), fleet=job.fleet
    )


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Say what would be fitted and held out, and which parameters the poses tell."""
    options = _core(job.options)
    with found.noting_refusals():
        if are_logs(job):
            found.count_fitted_rows(Observations.concatenate(list(job.campaigns.values())))
            return
        doubts(job.robot, _campaigns_with_validation(job), job.devices, job.options.sheet_order)
        train, validation = _rows(job, Setups(options.refit, job.devices))
        found.count_fitted_rows(train)
        _refuse_mixed_up(job, train, validation)
        if isinstance(validation, Observations):
            refuse_shared_rows(train, validation, "validation")
            found.hold("campaigns", validation)
        elif isinstance(validation, core_identify.Folds):
            found.hold("folds", train)
            next(core_identify.fold_splits(train, validation.folds, options.seed))
        elif validation is not None:
            core_identify.measurement_for(train, options)
            inside, outside = core_identify.split(train, validation, options.seed)
            found.hold("fraction", train.select(outside))
            train = train.select(inside)
            options = core_identify.between_rows(options, train)
        found.identification = core_identify.check_identification(job.robot, train, options, job.start, job.fleet)
        found.missing += [Lack(u.name, u.reason, u.remedy) for u in found.identification.unknown]


def _refuse_mixed_up(job: JobInput, train: Observations, validation: Observations | float | Folds | None) -> None:
    begin = job.start or core_model.Calibration.nominal(job.robot)
    for rows in (train, validation):
        if isinstance(rows, Observations):
            core_identify.refuse_mixed_up(begin, rows)


def _campaigns_with_validation(job: JobInput) -> list[tuple[str, Observations]]:
    return [*job.campaigns.items(), *(job.validation.items() if isinstance(job.validation, dict) else ())]


def _rows(job: JobInput, setups: Setups) -> tuple[Observations, Observations | float | core_identify.Folds | None]:
    """Rows to fit or to split, and what validates, poses and sessions numbered apart."""
    job.refuse_rows_of_start()
    parts = renumber_poses_and_sessions(setups.number_setups(_campaigns_with_validation(job)))
    if isinstance(job.validation, dict):
        train, held = parts[: len(job.campaigns)], parts[len(job.campaigns) :]
        return Observations.concatenate(train), Observations.concatenate(held)
    validation = core_identify.Folds(job.validation) if isinstance(job.validation, int) else job.validation
    return Observations.concatenate(parts), validation


def _prior(job: JobInput) -> core_identify.Prior | None:
    """What the start knows of its parameters, for the methods that continue from it."""
    known = job.covariance or {}
    return core_identify.Prior(tuple(known["names"]), np.array(known["matrix"])) if known.get("names") else None


def _core(options: IdentifyOptions) -> core_identify.IdentifyOptions:
    """What was asked, as the core has it: whatever was not keeps the core's default."""
    return core_identify.IdentifyOptions.from_document(options.model_dump(mode="json", exclude=NOT_OF_THE_CORE))


def describe_preview(found: JobPreview) -> dict[str, Any]:
    """Say what the poses tell of the parameters."""
    return {"identifiability": None if found.identification is None else _identifiability(found.identification)}


def _identifiability(found: IdentificationCheck) -> Identifiability:
    return Identifiability(
        parameters=len(found.names),
        rank=found.rank,
        identifiable=list(found.known),
        not_identifiable=[UnknownParameter(name=u.name, reason=u.reason, remedy=u.remedy) for u in found.unknown],
        null_directions=[NullDirection(**direction) for direction in found.directions],
        noise_mm=to_mm(found.noise),
        noise_from=found.noise_source,
    )


KIND = JobKind(IDENTIFY, run, check, preview_job=preview_job, describe_preview=describe_preview)


def doubts(
    robot: Robot, campaigns: Iterable[tuple[str, Observations]], devices: dict[str, str], option: object
) -> list[FindingDocument]:
    """Warnings about the order of the quarter points of every drawn sheet.

    Raises:
        ObservationError: an order in which the sheet cannot have been drawn by this robot.

    """
    drawn = [
        (campaign if session is None else f"{campaign} session {session}", sheet)
        for campaign, rows in campaigns
        if option != GIVEN and devices.get(campaign, "").strip().lower() in LAID_AGAIN
        for session, sheet in _sheets(rows)
    ]
    return list(_check_sheet_orders(robot, drawn)) if drawn else []


def bar_lengths(
    found: Identification, robot: Robot, campaigns: Iterable[tuple[str, Observations]], again: Again
) -> list[FindingDocument]:
    """Warnings about ball bars of another length than was read, after the fit: the nominal arm only raises the question.

    ``again(campaign, rows)`` is the same identification with other rows of a campaign, None of one that was not fitted.
    """
    nominal = core_model.Calibration.nominal(robot)
    asked = [(name, rows, *one) for name, rows in campaigns for one in core_identify.other_lengths(nominal, rows)]
    out = []
    for campaign, rows, bar, read, length in asked:
        other = again(campaign, core_identify.scale_bar_readings(rows, bar, length / read))
        if other is None:
            wrong = bar in {number for number, _, _ in core_identify.other_lengths(found.calibration, rows)}
        else:
            wrong = core_identify.explains_better(other.fit, found.fit)
        if wrong:
            out.append(_other_length(campaign, bar, read, length))
    return out


def _other_length(campaign: str, bar: int, read: float, found: float) -> FindingDocument:
    return FindingDocument.make(
        "bar_length_doubtful",
        f"{campaign}: bar {bar} reads {to_mm(read):.3f} mm, but the joints put the tool {to_mm(found):.3f} mm "
        f"from the ball at its fixed end ({found / read:.4g} times), and the rows fit that length better. Is the stated "
        "nominal length wrong? Give the right one (kilter measure ballbar-join --radius-mm, or the line above the "
        "log) and upload "
        "again.",
    )


def _sheets(rows: Observations) -> Iterator[tuple[int | None, Observations]]:
    if rows.session is None:
        yield None, rows
        return
    for session in np.unique(rows.session):
        yield int(session), rows.select(rows.session == session)


def _check_sheet_orders(robot: Robot, drawn: list[tuple[str, Observations]]) -> Iterator[FindingDocument]:
    """Judge all sheets together: they are of one arm, and an order that helps one of them must not spoil another."""
    for (name, _), found in zip(drawn, core_identify.sheet_orders(robot, [sheet for _, sheet in drawn]), strict=True):
        if found is None:
            continue
        if found.wrong:
            raise ObservationError(
                f"{name} was joined with its quarter points in the wrong order: {found.sentence()}. If you know that the "
                f'order is right, say so with the option {OPTION} "{GIVEN}".',
                code="sheet_order_wrong",
                order=list(found.order),
            )
        if found.doubtful or found.unseen:
            yield FindingDocument.make("sheet_order_doubtful", _doubt(name, found))


def _doubt(name: str, found: SheetOrder) -> str:
    if found.doubtful:
        order = ", ".join(map(str, found.order))
        return (
            f"{name}: its line fits this robot better with the quarter points in the order {order} "
            f"({to_mm(found.left):.3f} mm are left, {to_mm(found.as_given):.3f} mm as given). Check which point was the first."
        )
    return (
        f"{name}: its line fits this robot in several orders of the quarter points equally well, so the order was not checked. "
        "Make sure that row 1 of the points file is point 1; strokes across the line and a larger circle tell more."
    )
