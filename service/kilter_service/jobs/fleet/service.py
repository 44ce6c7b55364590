"""What can be done with fleet jobs. The jobs of the robots are ordinary ones: any number of workers takes part.

How the version that a job of a fleet made compares with the one before, as its activation would find.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from pydantic import TypeAdapter, ValidationError

from kilter_core.errors import CoreError, FindingDocument
from kilter_service.campaigns import store as campaigns
from kilter_service.campaigns.store import CampaignRecord
from kilter_service.contract.jobs.fleet import (
    FleetCounts,
    FleetJob,
    FleetJobList,
    FleetJobSummary,
    FleetRobot,
    NewFleetJob,
)
from kilter_service.contract.jobs.identify import IDENTIFY, IdentifyOptions
from kilter_service.contract.jobs.kind import FINAL, JobError, NewJobOf, Progress, State
from kilter_service.contract.versions import Comparison, Objection
from kilter_service.contract.wording import Remark, as_written
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import ALL, Page, in_time
from kilter_service.jobs import service as single_jobs
from kilter_service.jobs import store as jobs
from kilter_service.jobs.fleet import store
from kilter_service.jobs.fleet.store import FleetRecord, FleetRobotRecord, Planned
from kilter_service.jobs.kind import VersionContent
from kilter_service.jobs.kinds import identify
from kilter_service.jobs.records import Asked, JobRecord, UsedRecord
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.guard import judge_unstored
from kilter_service.versions.store import Training
from kilter_service.web import logs
from kilter_service.web.routing import NOT_REPEATED, Once, hash_document

ANSWER = TypeAdapter(FleetJobSummary)


def submit(database: Database, fleet: NewFleetJob, once: Once = NOT_REPEATED) -> FleetJobSummary:
    """Plan a job for each robot and queue them together; a robot that cannot be identified gets a refusal in words.

    Raises:
        ServiceError: no such robot, or too many. CoreError: options that do not go together.

    """
    body = hash_document(fleet)
    with database.reading() as session:
        known = once.first_answer(session, body, ANSWER)
        if known is not None:
            return known
        names = resolve_robot_names(session, fleet)
    if fleet.options is not None:
        identify.KIND.check(fleet.options)
    planned = [plan_robot_job(database, fleet, robot) for robot in names]
    with database.transaction() as session:
        known = once.first_answer(session, body, ANSWER)
        if known is not None:
            return known
        fleet_id = store.add(session, fleet, planned, Asked(logs.request_id(), logs.traceparent()))
        return once.keep(session, body, summary(store.get(session, fleet_id)))


def get(database: Database, fleet_id: str) -> FleetJob:
    """Return a fleet job with a row for each robot."""
    with database.reading() as session:
        return _fleet_job(session, fleet_id)


def list_fleet_jobs(database: Database, page: Page) -> FleetJobList:
    """List the newest fleet jobs."""
    with database.reading() as session:
        found = store.newest_fleet_jobs(session, page)
    shown, cursor = page.cut(found, lambda one: in_time(one.created_at, one.id))
    return FleetJobList(fleet_jobs=[summary(one) for one in shown], next=cursor)


def cancel(database: Database, fleet_id: str) -> FleetJob:
    """Cancel the jobs of a fleet job that are not over; versions that were made stay.

    Raises:
        ServiceError: all jobs are over, and it was not cancelled before.

    """
    with database.transaction() as session:
        found = store.get(session, fleet_id)
        if not store.cancel(session, fleet_id) and found.cancelled_at is None:
            raise ServiceError(
                f"All jobs of fleet job {fleet_id} are over: nothing is left to cancel.", code="job_finished"
            )
        return _fleet_job(session, fleet_id)


def _fleet_job(session: Session, fleet_id: str) -> FleetJob:
    return fleet_job(store.get(session, fleet_id), store.robots_of_fleet_job(session, fleet_id))


def fleet_job(record: FleetRecord, robots: Sequence[FleetRobotRecord]) -> FleetJob:
    """Say all of a fleet job."""
    return FleetJob(**_summary_fields(record), report=[_robot(one) for one in robots])


def summary(record: FleetRecord) -> FleetJobSummary:
    """Say what lists tell of a fleet job."""
    return FleetJobSummary(**_summary_fields(record))


def _summary_fields(record: FleetRecord) -> dict[str, Any]:
    counts = FleetCounts(**{one.state or "refused": one.number for one in record.counts})
    robots = sum(one.number for one in record.counts)
    over = robots - counts.queued - counts.running
    ended = sum(one.number if one.state is None or one.state in FINAL else one.fraction for one in record.counts)
    return {
        "id": record.id,
        "name": record.name,
        "state": _state(record, counts, over == robots),
        "progress": Progress(fraction=ended / max(robots, 1), stage=f"{over} of {robots} robots"),
        "robots": robots,
        "counts": counts,
        "created_at": record.created_at,
        "finished_at": _finish_time(record) if over == robots else None,
    }


def _state(record: FleetRecord, counts: FleetCounts, over: bool) -> State:
    if not over:
        return "running" if counts.running or counts.succeeded or counts.failed else "queued"
    if record.cancelled_at is not None:
        return "cancelled"
    return "succeeded" if counts.succeeded else "failed"


def _finish_time(record: FleetRecord) -> datetime:
    """The last end of its jobs; where no robot got one it was over at once."""
    return max((one.finished_at for one in record.counts if one.finished_at is not None), default=record.created_at)


def _robot(one: FleetRobotRecord) -> FleetRobot:
    request, error, judged = one.request or {}, one.refusal or one.error, one.judged or {}
    compared = None if judged.get("compared") is None else as_written(Comparison, judged["compared"])
    held_out_before, held_out_after = _held_out(compared)
    return FleetRobot(
        robot=one.robot,
        state=one.state or "refused",
        job_id=one.job_id,
        campaigns=request.get("campaigns") or [],
        validation=request.get("validation"),
        version_before=one.before_id,
        version_id=one.version_id,
        held_out_before_mm=held_out_before,
        held_out_after_mm=held_out_after,
        compared=compared,
        objections=as_written(list[Objection], judged.get("objections") or []),
        warnings=as_written(list[Remark], judged.get("warnings") or []),
        error=None if error is None else JobError(code=error["code"], message=error["message"]),
    )


def _held_out(compared: Comparison | None) -> tuple[float | None, float | None]:
    """Mean errors before and after on the same poses; without a version before only after, on all that were held out."""
    if compared is None:
        return None, None
    if compared.active is None:
        return None, compared.mean_mm
    return compared.active.mean_mm, compared.active.mean_mm + compared.active.larger_by_mm


MOST = 1000  # robots of one fleet job: it is planned and queued within a request


def resolve_robot_names(session: Session, fleet: NewFleetJob) -> list[str]:
    """Return the names of the robots, each once.

    Raises:
        ServiceError: there are none, too many, or campaigns of a robot that is not among them.

    """
    if fleet.robots is None:
        found = [one.name for one in robots.robots_on_page(session, Page(limit=MOST))]
    else:
        found = [robots.get(session, name).name for name in dict.fromkeys(fleet.robots)]
    if not found:
        raise ServiceError("The fleet job names no robot: give at least one in `robots`.", code="robot_not_found")
    if len(found) > MOST:
        raise ServiceError(
            f"There are more than {MOST} robots: name at most {MOST} in `robots`, and ask again for the others.",
            code="option_invalid",
            option="robots",
        )
    strange = sorted(set(fleet.campaigns) - set(found))
    if strange:
        raise ServiceError(
            f"`campaigns` names robot {strange[0]!r}, which is not among the robots: add it to `robots`, or leave it out.",
            code="campaigns_invalid",
            robot=strange[0],
        )
    return found


def plan_robot_job(database: Database, fleet: NewFleetJob, robot: str) -> Planned:
    """Plan one robot; what its job would be refused with is its refusal."""
    with database.reading() as session:
        robot_id = robots.get(session, robot).id
        last = versions.active_entry(session, robot_id)
        before = None if last is None else last.version_id
        try:
            job = _job(session, fleet, robot, robot_id, before)
            single_jobs.validate_job(session, job, identify.KIND)
        except CoreError as error:
            return Planned(robot_id, before, refusal=(error.code, error.message))
    if fleet.options is None:  # those that are given for all were checked once
        try:
            identify.KIND.check(job.options)  # may import the core and take its time: outside
        except CoreError as error:
            return Planned(robot_id, before, refusal=(error.code, error.message))
    return Planned(robot_id, before, job)


def _job(
    session: Session, fleet: NewFleetJob, robot: str, robot_id: int, before: str | None
) -> NewJobOf[IdentifyOptions]:
    robots.refuse_retired_robot(session, robot_id)
    given = fleet.campaigns.get(robot)
    fitted, held = (given, []) if given is not None else _latest(session, robot, robot_id, before)
    return IDENTIFY.request(
        kind="identify",
        robot=robot,
        name=fleet.name,
        campaigns=fitted,
        validation=held or fleet.validation,
        options=fleet.options or _options(session, before),
    )


def _latest(session: Session, robot: str, robot_id: int, before: str | None) -> tuple[list[str], list[str]]:
    """The campaigns that the active version and those it continues were made from, and those since, by their roles."""
    fitted, held, since = _of_version(session, before) if before else (set[str](), set[str](), None)
    there = _with_rows(session, robot_id)
    for one in there:
        if since is None or one.created_at > since:
            (fitted if one.role == "train" else held if one.role == "validation" else set()).add(one.id)
    in_use = [one.id for one in there]
    chosen = [c for c in in_use if c in fitted]
    if not chosen:
        raise ServiceError(
            f"Robot {robot!r} has no campaign to identify it from: upload one (kilter upload {robot} FILE), bring one back "
            "with `kilter measure campaigns restore`, or name campaigns.",
            code="campaigns_invalid",
            robot=robot,
        )
    return chosen, [c for c in in_use if c in held - fitted]


def _of_version(session: Session, version_id: str) -> tuple[set[str], set[str], datetime]:
    """Campaigns that were fitted and held out, and when that was asked for."""
    record = versions.get(session, version_id)
    fitted = {campaign for one in versions.trainings(session, version_id) for campaign, _ in one.campaigns}
    held = {used["id"] for used in record.campaigns if used["use"] == "validation"}
    return fitted, held, jobs.get(session, record.job_id).created_at


def _with_rows(session: Session, robot_id: int) -> Sequence[CampaignRecord]:
    found = campaigns.campaigns_on_page(session, robot_id, staged=False, page=ALL)
    return [one for one in found if campaigns.uploads_of_campaign(session, one.id)]


def _options(session: Session, before: str | None) -> IdentifyOptions:
    """The options of the identification that made a version; of another job those that identify the same effects."""
    if before is None:
        return IdentifyOptions()
    record = versions.get(session, before)
    job = jobs.get(session, record.job_id)
    if job.kind == "identify":
        asked = {name: value for name, value in job.request.options.items() if name != "start"}
        return as_written(IdentifyOptions, asked)
    try:
        return IdentifyOptions.model_validate({"level": 3, "effects": record.calibration["effects"]})
    except ValidationError as error:
        raise ServiceError(
            f"Version {before} was made by a {job.kind} job, and its effects cannot be identified as they are: give "
            "`options`.",
            code="option_invalid",
            option="effects",
        ) from error


def compare_with_previous(
    database: Database, job_id: str, version: VersionContent | None, used: Sequence[UsedRecord]
) -> dict[str, Any] | None:
    """Return what the fleet's report says of a version that is not stored yet; None: its job is of no fleet job."""
    if version is None:
        return None
    with database.reading() as session:
        found = store.version_before_fleet_job(session, job_id)
        job = jobs.get(session, job_id)
    if found is None:
        return None
    try:
        verdict = judge_unstored(
            database, job.robot_id, version.calibration, version.report, version.limits, _training(job, used), found[0]
        )
    except CoreError as error:  # the version counts without it
        return {"warnings": [FindingDocument.make(error.code, error.message)]}
    return {
        "compared": None if verdict.compared is None else verdict.compared.model_dump(mode="json"),
        "objections": [one.model_dump(mode="json") for one in verdict.objections],
        "warnings": list(verdict.warnings),
    }


def _training(job: JobRecord, used: Sequence[UsedRecord]) -> Training:
    """What the version is fitted to, as it will be known when it is stored."""
    held = job.request.validation
    campaigns = tuple(dict.fromkeys((one.id, tuple(one.sha256)) for one in used if one.use == "train"))
    seed = int(job.request.options.get("seed", IdentifyOptions.model_fields["seed"].default))
    return Training(job.kind, campaigns, held if isinstance(held, float) and held > 0.0 else None, seed)
