"""Job kind ``drift``: whether an arm has moved since its version was made, by a few poses measured again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError, FindingDocument, ObservationError, OptionError
from kilter_service.contract.jobs.drift import DRIFT, DriftOptions
from kilter_service.ground.core import core_identify, core_measurement, core_watch
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.budgets import uncertainty_budget
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Progress
from kilter_service.jobs.setups import build_check_conditions, counted_noise, remark, to_json_types
from kilter_service.versions.drift import wire
from kilter_service.versions.drift.wire import last_otherwise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations
    from kilter_core.watch import Check

# Codes with which the rows themselves are refused, whatever the options say.
REFUSED = frozenset(
    {"rows_of_another_arm", "too_few_poses", "tool_not_stated", "another_temperature", "contacts_mixed"}
)
MOST_ROWS = 10  # named
MOST_DRAWN, MOST_CAUSES = 60, 4  # rows and causes that are drawn
STAYS = (
    " Campaign {campaign} is still in use: retire it, on its page or by `kilter measure campaigns retire "
    "{campaign}`, so that nothing "
    "is compared with it."
)


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Check the rows of the campaign against the version named, else the active one."""
    progress(0.0, "comparing")
    rows, known = comparable_rows(job), get_predictive(job)
    found = run_drift_check(job, rows, known)
    return JobOutput(to_json_types(_document(job, rows, known, found)))


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Check, which takes no time, and say only what would be refused."""
    found.count_fitted_rows(*job.campaigns.values())
    with found.noting_refusals():
        try:
            run_drift_check(job, comparable_rows(job), get_predictive(job))
        except CoreError as error:
            if error.code not in REFUSED:
                raise
            (campaign,) = job.campaigns
            raise type(error)(
                error.message.rstrip() + STAYS.format(campaign=campaign), code=error.code, **error.context
            ) from None


def run_drift_check(job: JobInput, rows: Observations, known: Predictive) -> Check:
    """Return what the core says of the rows."""
    options: DriftOptions = job.options
    calibration = applied_calibration(job)
    noise = counted_noise(job, known)
    return core_watch.check(
        calibration,
        rows,
        known,
        noise=noise,
        new_setup=options.new_setup,
        fitted_c=job.fit.temperatures_c,
        conditions=build_check_conditions(job, noise),
    )


def comparable_rows(job: JobInput) -> Observations:
    """The rows of the one campaign of which the version can say where the tool should be.

    Raises:
        ObservationError: the version was fitted to them.

    """
    ((campaign, rows),) = job.campaigns.items()
    if campaign in job.fit.shared:
        raise ObservationError(
            f"The version was fitted to rows of campaign {campaign}: they agree with it whatever the arm does. Measure some "
            "poses again, and check with them.",
            code="rows_shared",
            campaign=campaign,
        )
    unknown = _unknown_sides(job)
    return rows.select(~unknown) if unknown.any() else rows


def _unknown_sides(job: JobInput) -> NDArray[np.bool_]:
    """Which rows (N,) the version cannot predict, for nobody knows from which side joints with backlash came."""
    ((_, rows),) = job.campaigns.items()
    if job.calibration is None:
        return np.zeros(len(rows), dtype=bool)
    return job.calibration.unknown_sides(rows)


def applied_calibration(job: JobInput) -> Calibration:
    """The version as it predicts the rows of the one campaign."""
    ((campaign, _),) = job.campaigns.items()
    found = job.applied_to(campaign)
    assert found is not None
    return found


def get_predictive(job: JobInput) -> core_identify.Predictive:
    """What the version knows of itself.

    Raises:
        OptionError: there is no version, or it knows nothing.

    """
    if job.calibration is None:
        raise OptionError(
            "The robot has no active version to check against: activate one, or name it in options.version.",
            option="version",
        )
    known = core_identify.Predictive.from_document(job.covariance or {}, job.report)
    if known is None:
        raise OptionError(
            f"Version {job.version_id} does not say how well it is known: identify one from measurements of the tool, and "
            "check against that.",
            option="version",
        )
    return known


def _document(job: JobInput, rows: Observations, known: Predictive, found: Check) -> dict[str, Any]:
    # How far balls in a socket are from each other is not an error of the tool: it lacks what moves all of them alike.
    measured = () if found.joint_log else job.campaigns
    documents = {one.cause.name: wire.cause_document(one) for one in found.judged}
    drawn = None if found.joint_log else _rows(job, rows, found)
    for cause, left in () if drawn is None else drawn.left_mm.items():
        documents[cause]["left_mm"] = left
    causes = [documents[one.cause.name] for one in found.causes]
    since = last_otherwise(causes, to_mm(found.noise), found.poses, job.fit.agreeing)
    return {
        "version_id": job.version_id,
        "verdict": found.verdict,
        "sentence": wire.sentence(found, since),
        "agreed_at": None if since is None else since.isoformat(),
        "remedy": wire.remedy(found, applied_calibration(job).names),
        "causes": causes,
        "looked_at": list(documents.values()),
        "rows": None if drawn is None else drawn.rows,
        "p_value": found.p_value,
        "false_alarm": core_watch.FALSE_ALARM,
        "chi_square": found.chi_square,
        "numbers": found.numbers,
        "poses": found.poses,
        "lengths": "by_views" if found.by_views else "at_tool",
        "misfit_mm": to_mm(found.misfit),
        "noise_mm": to_mm(found.noise),
        "expected_mm": to_mm(known.inadequacy),
        "smallest": wire.smallest_documents(found),
        "unseen": [wire.cause_words(one) for one in found.unseen],
        "joint_log": found.joint_log,
        "new_setup": list(found.new_setup),
        "setup_mm": to_mm(found.conditions.setup),
        "within_k": found.conditions.within_k,
        "scatter": found.scatter,
        "temperature_c": None if rows.temperature_c is None else float(rows.temperature_c.mean()),
        "fitted_c": job.fit.temperatures_c,
        "warnings": list(_warnings(job, known)),
        "refit": list(found.new_setup),
        "metrics": {campaign: _errors(job, rows, known, found) for campaign in measured},
    }


@dataclass(frozen=True)
class _Drawn:
    """Rows as documents, and by cause the error of each, mm, that is left if it is the cause."""

    rows: list[dict[str, Any]]
    left_mm: dict[str, list[float]]


def _rows(job: JobInput, rows: Observations, found: Check) -> _Drawn | None:
    """Errors of the worst rows with the version, and with each of the likeliest causes; None where no place was seen."""
    calibration = applied_calibration(job)
    measurement = core_measurement.Measurement.from_observations(rows, calibration.marker_points, held=True)
    if measurement.tool.places_itself or not measurement.observes_places:
        return None
    here = core_identify.refit_frames(calibration, measurement, found.new_setup)
    model, values = here.model.absorb_frame_increments(here.values)
    here = replace(here, model=model, values=values)
    predicted = here.predict(measurement.observations)
    error = to_mm(core_identify.mean_marker_error(measurement.residual(predicted).points))
    size = np.where(np.isnan(error).any(axis=1), -1.0, np.linalg.norm(error, axis=1))
    shown = np.sort(np.argsort(-size, kind="stable")[: min(MOST_DRAWN, int((size >= 0.0).sum()))])
    left = {}
    for one in found.judged[:MOST_CAUSES]:
        changed, moved, unit = core_watch.apply_cause(here, measurement.observations, one.cause, one.change)
        shift = to_mm(unit * changed.predict(moved).position - predicted.position)
        left[one.cause.name] = (error - shift)[shown]
    after = left[found.causes[0].cause.name] if found.causes and found.causes[0].cause.name in left else None
    at, numbers = to_mm(predicted.position), np.flatnonzero(~_unknown_sides(job))
    documents = [
        {
            "row": int(numbers[k]) + 1,
            "at_mm": at[k].tolist(),
            "error_mm": error[k].tolist(),
            "after_mm": None if after is None else after[place].tolist(),
        }
        for place, k in enumerate(shown)
    ]
    return _Drawn(documents, {name: np.linalg.norm(one, axis=1).tolist() for name, one in left.items()})


def _warnings(job: JobInput, known: Predictive) -> Iterator[FindingDocument]:
    yield from _of_dates(job)
    unknown = np.flatnonzero(_unknown_sides(job)) + 1
    if len(unknown):
        named = f"row{'s' if len(unknown) > 1 else ''} {', '.join(str(row) for row in unknown[:MOST_ROWS])}"
        said = f"Not counted: {named}. From which side joints with backlash came to them is not known."
        remedy = "Drive to one pose more before the first."
        yield FindingDocument.make("side_unknown", f"{said} {remedy}", campaigns=list(job.campaigns))
    other = remark(job, known)
    if other is not None:
        yield other


def _of_dates(job: JobInput) -> Iterator[FindingDocument]:
    """Say that rows are dated before what they should come after: a clock that was set back puts a check in another place."""
    dates, (campaign,) = job.fit.dates, job.campaigns
    at = dates.rows
    for code, other in (("dated_before_last_check", dates.last_check), ("dated_before_fit", dates.fitted)):
        if at is not None and other is not None and at < other:
            yield FindingDocument.make(code, wire.dated_before(code, campaign, at, other), campaigns=[campaign])


def _errors(job: JobInput, rows: Observations, known: Predictive, found: Check) -> dict[str, Any]:
    """Errors of the version on the rows, the numbers of an evaluation.

    Base and tool of the nominal robot are not fitted to a few poses beside it: they would take up most of the errors.
    """
    calibration = applied_calibration(job)
    measurement = core_measurement.Measurement.from_observations(rows, calibration.marker_points, held=True)
    errors = core_measurement.Errors.from_calibration(
        core_identify.refit_frames(calibration, measurement, found.new_setup), measurement
    )
    ((campaign, _),) = job.campaigns.items()
    budget = uncertainty_budget(calibration, known, rows, job.instruments.get(campaign), found.new_setup)
    nominal = core_identify.refit_frames(calibration.nominal_in_wanted_frames(), measurement, found.new_setup)
    without = core_measurement.Errors.from_calibration(nominal, measurement)
    return {
        "n": len(errors.points),
        "left_out": 0,
        "identified": errors.to_document(),
        "uncorrected": without.to_document(),
        "budget": budget,
    }


KIND = JobKind(DRIFT, run, preview_job=preview_job)
