"""Jobs that have ended: counts by kind, state and how long they took, and what the newest search in torques found."""

from __future__ import annotations

from bisect import bisect_left
from datetime import timedelta
from typing import Any

from sqlalchemy import Select, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import EndedJobsRow, JobRow
from kilter_service.ground.errors import ServiceError

# Counted are jobs up to each, and no longer than it; the bins may change with a release, what was counted keeps its own.
AT_MOST_MS = (250, 1000, 2500, 5000, 10_000, 30_000, 60_000, 120_000, 300_000, 600_000, 1_800_000, 3_600_000)
LONGER_MS = 2**31 - 1
NEVER_RAN = 0


def count(session: Session, row: JobRow) -> None:
    """Count a job that has just ended, in the transaction that ends it."""
    took = _took(row)
    key = (row.kind, row.state, NEVER_RAN if took is None else _duration_bin(took))
    counted = session.get(EndedJobsRow, key)
    if counted is None:
        counted = EndedJobsRow(kind=row.kind, state=row.state, at_most_ms=key[2], jobs=0, seconds=0.0)
        session.add(counted)
    counted.jobs += 1
    counted.seconds += 0.0 if took is None else took.total_seconds()


def _took(row: JobRow) -> timedelta | None:
    if row.started_at is None or row.finished_at is None:
        return None
    return max(timedelta(0), row.finished_at - row.started_at)  # the clock may have been set back


def _duration_bin(took: timedelta) -> int:
    at = bisect_left(AT_MOST_MS, took / timedelta(milliseconds=1))
    return AT_MOST_MS[at] if at < len(AT_MOST_MS) else LONGER_MS


def list_searches_in_torques(session: Session, robot_id: int, limit: int) -> list[tuple[str, str]]:
    """Return id and name of the newest searches in torques of a robot that have a model, the newest first."""
    found = session.execute(_searches_in_torques(robot_id).limit(limit))
    return [(job_id, name) for job_id, name, _ in found]


def _searches_in_torques(robot_id: int) -> Select[tuple[str, str, Any]]:
    row = JobRow
    model = row.result["motion"]["model"]
    return (
        select(row.id, row.name, model)
        .where(
            row.robot_id == robot_id,
            row.kind.in_(("gap", "identify")),
            row.state == "succeeded",
            model["base"].as_string().is_not(None),
        )
        .order_by(row.created_at.desc(), row.id)
    )


def get_search_in_torques(
    session: Session, robot_id: int, job_id: str | None = None
) -> tuple[str, str, dict[str, Any]]:
    """Return id, name and model of the newest search in torques of a robot, or of the one that is named.

    Raises:
        ServiceError: ``no_torque_model``: there is none.

    """
    query = _searches_in_torques(robot_id)
    if job_id is not None:
        query = query.where(JobRow.id == job_id)
    found = session.execute(query.limit(1)).one_or_none()
    if found is None:
        raise ServiceError(
            f"No search in torques of this robot has a model{'' if job_id is None else f' by the id {job_id!r}'}: upload a log "
            "with t_s and tau1_nm ..., and search it (kilter gap).",
            code="no_torque_model",
        )
    return found[0], found[1], found[2]
