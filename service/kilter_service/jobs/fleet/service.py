"""What can be done with fleet jobs. The jobs of the robots are ordinary ones: any number of workers takes part."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from pydantic import TypeAdapter

from kilter_service.contract.jobs.fleet import (
    FleetCounts,
    FleetJob,
    FleetJobList,
    FleetJobSummary,
    FleetRobot,
    NewFleetJob,
)
from kilter_service.contract.jobs.job import FINAL, JobError, Progress, State
from kilter_service.contract.remarks import Remark
from kilter_service.contract.versions import Comparison, Objection
from kilter_service.contract.written import as_written
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, in_time
from kilter_service.jobs.fleet import planning, store
from kilter_service.jobs.fleet.store import FleetRecord, FleetRobotRecord
from kilter_service.jobs.kinds import identify
from kilter_service.jobs.records import Asked
from kilter_service.web.idempotency.key import NOT_REPEATED, Once, hash_document
from kilter_service.web.observability import logs, tracing

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
        names = planning.resolve_robot_names(session, fleet)
    if fleet.options is not None:
        identify.KIND.check(fleet.options)
    planned = [planning.plan_robot_job(database, fleet, robot) for robot in names]
    with database.transaction() as session:
        known = once.first_answer(session, body, ANSWER)
        if known is not None:
            return known
        fleet_id = store.add(session, fleet, planned, Asked(logs.request_id(), tracing.traceparent()))
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
