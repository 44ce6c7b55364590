"""Rows of jobs as the queue they are. Every change is alone in the database (`Database.transaction`), so none can overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, Select, and_, delete, or_, select, update

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import NOT_OVER, HeartbeatRow, JobRow
from kilter_service.ground.ended_jobs import store as ended

WORKER = "worker"  # the process of the heartbeats that count here
MAX_ATTEMPTS = 10  # a job that has ended its worker this often would go on doing so


def query_for_free_jobs(kinds: Sequence[str], worker: str) -> Select[str]:
    """Return the query for a job to claim."""
    return select(JobRow.id).where(_free(kinds, worker)).limit(1)


def claim(session: Session, worker: str, kinds: Sequence[str]) -> Claim | None:
    """Take the oldest job of some kinds; None when there is none.

    Call it when the worker runs none of these kinds: a job that the row says it runs was claimed when the connection broke.
    """
    query = select(JobRow).where(_free(kinds, worker)).order_by(JobRow.created_at, JobRow.id).limit(1)
    row = session.execute(query).scalar_one_or_none()
    if row is None:
        return None
    row.state, row.worker, row.attempts, row.started_at = (
        "running",
        worker,
        row.attempts + 1,
        row.started_at or utc_now(),
    )
    return Claim(row.id, worker, row.attempts)


def _free(kinds: Sequence[str], worker: str) -> ColumnElement[bool]:
    lost = and_(JobRow.state == "running", JobRow.worker == worker)
    return and_(NOT_OVER, JobRow.kind.in_(kinds), or_(JobRow.state == "queued", lost))


def _claim_condition(claim: Claim) -> ColumnElement[bool]:
    row = JobRow
    return and_(
        row.id == claim.job_id, row.state == "running", row.worker == claim.worker, row.attempts == claim.attempt
    )


def holds(session: Session, claim: Claim) -> bool:
    """Whether a claim is good still: nobody cancelled the job, and nobody thought its worker gone."""
    return session.execute(select(JobRow.id).where(_claim_condition(claim))).first() is not None


def advance(session: Session, claim: Claim, fraction: float, stage: str) -> bool:
    """Store the progress; returns whether the claim is good still."""
    values = {"fraction": min(max(fraction, 0.0), 1.0), "stage": stage[:200]}
    done = session.execute(update(JobRow).where(_claim_condition(claim)).values(**values).returning(JobRow.id))
    return done.first() is not None


def beats(session: Session) -> dict[str, datetime]:
    """Return when each worker last said that it is alive."""
    query = select(HeartbeatRow.name, HeartbeatRow.at).where(HeartbeatRow.process == WORKER)
    return {row.name: row.at for row in session.execute(query)}


def holders(session: Session) -> set[str]:
    """Return the workers that jobs say they run in."""
    return set(session.execute(select(JobRow.worker).where(NOT_OVER, JobRow.state == "running").distinct()).scalars())


def bury(session: Session, silent: Mapping[str, datetime]) -> None:
    """Take the heartbeats of workers away that have not spoken since."""
    row = HeartbeatRow
    for name, at in silent.items():
        session.execute(delete(row).where(row.process == WORKER, row.name == name, row.at == at))


def orphans(session: Session) -> list[str]:
    """Queue the jobs again whose worker has no heartbeat; returns their ids. Doing it twice changes nothing.

    A job that has ended ten workers fails.
    """
    alive = select(HeartbeatRow.name).where(HeartbeatRow.process == WORKER)
    found = _running(session, JobRow.worker.not_in(alive))
    for row in found:
        if row.attempts >= MAX_ATTEMPTS:
            message = f"The worker died {MAX_ATTEMPTS} times in this job: see its log."
            row.error = {"code": "internal_error", "message": message}
            row.state, row.stage, row.finished_at = "failed", "failed", utc_now()
            ended.count(session, row)
        else:
            _queue(row)
    return [row.id for row in found]


def give_back(session: Session, worker: str) -> None:
    """Queue the jobs of a worker again that was asked to stop."""
    for row in _running(session, JobRow.worker == worker):
        _queue(row)


def _running(session: Session, where: ColumnElement[bool]) -> Sequence[JobRow]:
    return (
        session.execute(select(JobRow).where(NOT_OVER, JobRow.state == "running", where).order_by(JobRow.id))
        .scalars()
        .all()
    )


def _queue(row: JobRow) -> None:
    row.state, row.fraction, row.stage = "queued", 0.0, "queued again: its worker has stopped"


@dataclass(frozen=True)
class Claim:
    """One run of a job: whoever claims the job next has another attempt."""

    job_id: str
    worker: str
    attempt: int
