"""Rows of fleet jobs. How far one is, its jobs say: nothing of that is stored twice."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import func, or_, select

from kilter_service.contract.jobs.fleet import NewFleetJob
from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.contract.jobs.kind import FINAL, NewJobOf
from kilter_service.ground.caller import allowed_robots
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import FleetJobRow, FleetRobotRow, JobRow, RobotRow, VersionRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.jobs import store as jobs
from kilter_service.jobs.records import Asked

GONE = ("robot_not_found", "The robot was deleted or retired while the fleet job was made.")


def add(session: Session, fleet: NewFleetJob, planned: Sequence[Planned], asked: Asked) -> str:
    """Store a fleet job and queue the jobs of its robots, all or none; returns its id."""
    request = fleet.model_dump(mode="json")
    row = FleetJobRow(id=f"flt_{uuid.uuid4().hex[:16]}", name=fleet.name, request=request)
    session.add(row)
    session.flush()
    in_use = set(session.execute(select(RobotRow.id).where(RobotRow.retired_at.is_(None))).scalars())
    there = set(session.execute(select(RobotRow.id)).scalars())
    for one in planned:
        if one.robot_id not in there:
            continue
        job = one.job if one.robot_id in in_use else None
        refusal = one.refusal or (None if job else GONE)
        session.add(
            FleetRobotRow(
                fleet_id=row.id,
                robot_id=one.robot_id,
                job_id=None if job is None else jobs.add(session, one.robot_id, job, asked),
                before_id=one.before,
                refusal=None if refusal is None else {"code": refusal[0], "message": refusal[1]},
            )
        )
    session.flush()
    return row.id


def get(session: Session, fleet_id: str) -> FleetRecord:
    """Return a fleet job.

    Raises:
        ServiceError: there is none, or it has robots that the caller may not see.

    """
    row = session.get(FleetJobRow, fleet_id)
    if row is None or not _visible(session, [fleet_id]):
        raise ServiceError(
            f"There is no fleet job {fleet_id!r}: list them with GET /v1/fleet-jobs.",
            code="job_not_found",
            fleet_job=fleet_id,
        )
    return _records(session, [row])[0]


def newest_fleet_jobs(session: Session, page: Page) -> list[FleetRecord]:
    """Return the newest fleet jobs that the caller may see, one more than the page shows."""
    row = FleetJobRow
    query = select(row).order_by(row.created_at.desc(), row.id)
    robots = allowed_robots()
    if robots is not None:
        query = query.where(row.id.not_in(_beyond(robots)))
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(row.created_at <= moment, or_(row.created_at < moment, row.id > key))
    return _records(session, session.execute(query.limit(page.fetch_limit)).scalars().all())


def _beyond(robots: frozenset[str]) -> Any:
    """The fleet jobs with robots that are not among these."""
    row = FleetRobotRow
    return select(row.fleet_id).join(RobotRow, RobotRow.id == row.robot_id).where(RobotRow.name.not_in(robots))


def _visible(session: Session, fleet_ids: Sequence[str]) -> bool:
    robots = allowed_robots()
    if robots is None:
        return True
    beyond = _beyond(robots).where(FleetRobotRow.fleet_id.in_(fleet_ids)).limit(1)
    return session.execute(beyond).first() is None


def _records(session: Session, rows: Sequence[FleetJobRow]) -> list[FleetRecord]:
    one = FleetRobotRow
    query = select(one.fleet_id, JobRow.state, func.count(), func.sum(JobRow.fraction), func.max(JobRow.finished_at))
    query = query.outerjoin(JobRow, JobRow.id == one.job_id).where(one.fleet_id.in_([row.id for row in rows]))
    found: dict[str, list[StateCount]] = {row.id: [] for row in rows}
    for fleet_id, state, number, fraction, finished in session.execute(query.group_by(one.fleet_id, JobRow.state)):
        found[fleet_id].append(StateCount(state, number, float(fraction or 0.0), finished))
    return [FleetRecord(row.id, row.name, row.created_at, row.cancelled_at, found[row.id]) for row in rows]


def robots_of_fleet_job(session: Session, fleet_id: str) -> list[FleetRobotRecord]:
    """Return the robots of a fleet job by name, without the results of their jobs."""
    one = FleetRobotRow
    query = (
        select(
            RobotRow.name,
            one.before_id,
            one.refusal,
            one.judged,
            one.job_id,
            JobRow.request,
            JobRow.state,
            JobRow.error,
            VersionRow.id,
        )
        .join(RobotRow, RobotRow.id == one.robot_id)
        .outerjoin(JobRow, JobRow.id == one.job_id)
        .outerjoin(VersionRow, VersionRow.job_id == one.job_id)
        .where(one.fleet_id == fleet_id)
        .order_by(RobotRow.name)
    )
    return [FleetRobotRecord(*found) for found in session.execute(query)]


def cancel(session: Session, fleet_id: str) -> bool:
    """Cancel all jobs of a fleet job that are not over; returns whether there were any."""
    one = FleetRobotRow
    query = select(JobRow.id).join(one, one.job_id == JobRow.id)
    left = session.execute(query.where(one.fleet_id == fleet_id, JobRow.state.not_in(FINAL))).scalars().all()
    for job_id in left:
        jobs.cancel(session, job_id)
    row = session.get_one(FleetJobRow, fleet_id)
    if left and row.cancelled_at is None:
        row.cancelled_at = utc_now()
    return bool(left)


def version_before_fleet_job(session: Session, job_id: str) -> tuple[str | None] | None:
    """Return the version that was active when the fleet job of a job was asked for; None: it is of no fleet job."""
    query = select(FleetRobotRow.before_id).where(FleetRobotRow.job_id == job_id)
    found = session.execute(query).first()
    return None if found is None else (found.before_id,)


def judge(session: Session, job_id: str, judged: Mapping[str, Any]) -> None:
    """Store how the version of a job compares with the one before."""
    query = select(FleetRobotRow).where(FleetRobotRow.job_id == job_id)
    row = session.execute(query).scalar_one_or_none()
    if row is not None:
        row.judged = dict(judged)


@dataclass(frozen=True)
class Planned:
    """What one robot is going to get: a job, or a refusal (its code and sentence). ``before`` is its active version."""

    robot_id: int
    before: str | None
    job: NewJobOf[IdentifyOptions] | None = None
    refusal: tuple[str, str] | None = None


@dataclass(frozen=True)
class FleetRobotRecord:
    """A robot of a fleet job, as it is stored with its job and version; ``state`` None: it was refused."""

    robot: str
    before_id: str | None
    refusal: Mapping[str, str] | None
    judged: Mapping[str, Any] | None
    job_id: str | None
    request: Mapping[str, Any] | None
    state: str | None
    error: Mapping[str, str] | None
    version_id: str | None


@dataclass(frozen=True)
class StateCount:
    """The jobs of a fleet job in one state (None: the robots without a job): how many, how far, and the last end."""

    state: str | None
    number: int
    fraction: float
    finished_at: datetime | None


@dataclass(frozen=True)
class FleetRecord:
    """A fleet job with the counts of its jobs."""

    id: str
    name: str
    created_at: datetime
    cancelled_at: datetime | None
    counts: Sequence[StateCount]
