"""What the database can say in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import func, select

from kilter_service.db import Session
from kilter_service.db.tables import HeartbeatRow, JobRow, now


@dataclass(frozen=True)
class Finished:
    """How long the jobs of a kind and an end took, those that finished lately."""

    kind: str
    state: str
    durations_s: Sequence[float]


def jobs_by_state(session: Session) -> list[tuple[str, str, int]]:
    """Return kind, state and number of all jobs."""
    query = select(JobRow.kind, JobRow.state, func.count()).group_by(JobRow.kind, JobRow.state)
    return [(kind, state, number) for kind, state, number in session.execute(query)]


def queue_age_s(session: Session) -> float:
    """Return for how long the oldest queued job has waited, 0 without one."""
    oldest = session.execute(select(func.min(JobRow.created_at)).where(JobRow.state == "queued")).scalar_one()
    return 0.0 if oldest is None else max(0.0, (now() - oldest).total_seconds())


def finished_since(session: Session, seconds: float) -> list[Finished]:
    """Return the durations of the jobs that finished in the last seconds."""
    since = now() - timedelta(seconds=seconds)
    query = select(JobRow.kind, JobRow.state, JobRow.started_at, JobRow.finished_at).where(
        JobRow.finished_at >= since, JobRow.started_at.is_not(None)
    )
    found: dict[tuple[str, str], list[float]] = {}
    for kind, state, started, ended in session.execute(query):
        assert started is not None
        assert ended is not None
        found.setdefault((kind, state), []).append((ended - started).total_seconds())
    return [Finished(kind, state, durations) for (kind, state), durations in found.items()]


def beats(session: Session) -> list[tuple[str, str, float]]:
    """Return kind, name and seconds since the last sign of life of every process."""
    moment = now()
    rows = session.execute(select(HeartbeatRow)).scalars()
    return [(row.process, row.name, (moment - row.at).total_seconds()) for row in rows]


def streams(session: Session) -> list[dict[str, Any]]:
    """Return what every stream of every corrector that runs has last said of itself."""
    query = select(HeartbeatRow.details).where(HeartbeatRow.process == "corrector")
    return [stream for details in session.execute(query).scalars() for stream in details.get("streams", [])]
