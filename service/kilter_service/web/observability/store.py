"""What the database can say in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import func, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import EndedJobsRow, HeartbeatRow, JobRow
from kilter_service.ground.ended_jobs.store import NEVER_RAN


@dataclass(frozen=True)
class Ended:
    """Jobs of a kind and an end: how many there were, how many of those that ran took at most so long, and all together."""

    jobs: int = 0
    seconds: float = 0.0
    at_most_ms: Mapping[int, int] = field(default_factory=dict)


def jobs_by_state(session: Session) -> list[tuple[str, str, int]]:
    """Return kind, state and number of all jobs."""
    query = select(JobRow.kind, JobRow.state, func.count()).group_by(JobRow.kind, JobRow.state)
    return [(kind, state, number) for kind, state, number in session.execute(query)]


def queue_age_s(session: Session) -> float:
    """Return for how long the oldest queued job has waited, 0 without one."""
    oldest = session.execute(select(func.min(JobRow.created_at)).where(JobRow.state == "queued")).scalar_one()
    return 0.0 if oldest is None else max(0.0, (utc_now() - oldest).total_seconds())


def ended_jobs(session: Session) -> dict[tuple[str, str], Ended]:
    """Return by kind and state what was counted of all jobs that have ended, also of those that were purged."""
    found: dict[tuple[str, str], Ended] = {}
    for row in session.execute(select(EndedJobsRow).order_by(EndedJobsRow.at_most_ms)).scalars():
        before = found.get((row.kind, row.state), Ended())
        ran = {row.at_most_ms: row.jobs} if row.at_most_ms != NEVER_RAN else {}
        found[row.kind, row.state] = Ended(
            before.jobs + row.jobs, before.seconds + row.seconds, {**before.at_most_ms, **ran}
        )
    return found


def beats(session: Session) -> list[tuple[str, str, float]]:
    """Return kind, name and seconds since the last sign of life of every process of the server.

    Bridges are none: one that has ended is remembered.
    """
    moment = utc_now()
    rows = session.execute(select(HeartbeatRow).where(HeartbeatRow.process != "bridge")).scalars()
    return [(row.process, row.name, (moment - row.at).total_seconds()) for row in rows]


def webhooks(session: Session) -> dict[str, dict[str, int]]:
    """Return how many verdicts each worker that has a webhook has posted and given up, by its name."""
    query = select(HeartbeatRow.name, HeartbeatRow.details).where(HeartbeatRow.process == "worker")
    return {name: details["webhook"] for name, details in session.execute(query) if "webhook" in (details or {})}


def streams(session: Session) -> list[dict[str, Any]]:
    """Return what every stream of every corrector that runs has last said of itself."""
    query = select(HeartbeatRow.details).where(HeartbeatRow.process == "corrector")
    return [stream for details in session.execute(query).scalars() for stream in details.get("streams", [])]
