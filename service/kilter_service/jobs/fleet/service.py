"""What can be done with fleet jobs. The jobs of the robots are ordinary ones: any number of workers takes part."""

from __future__ import annotations

from pydantic import TypeAdapter

from kilter_service.contract.jobs.fleet import FleetJob, FleetJobList, FleetJobSummary, NewFleetJob
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, in_time
from kilter_service.jobs.fleet import planning, store, wire
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
        return once.keep(session, body, wire.summary(store.get(session, fleet_id)))


def get(database: Database, fleet_id: str) -> FleetJob:
    """Return a fleet job with a row for each robot."""
    with database.reading() as session:
        return _fleet_job(session, fleet_id)


def list_fleet_jobs(database: Database, page: Page) -> FleetJobList:
    """List the newest fleet jobs."""
    with database.reading() as session:
        found = store.newest_fleet_jobs(session, page)
    shown, cursor = page.cut(found, lambda one: in_time(one.created_at, one.id))
    return FleetJobList(fleet_jobs=[wire.summary(one) for one in shown], next=cursor)


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
    return wire.fleet_job(store.get(session, fleet_id), store.robots_of_fleet_job(session, fleet_id))
