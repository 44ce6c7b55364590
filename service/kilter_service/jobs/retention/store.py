"""Rows of jobs that nothing needs any more."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import ColumnElement, delete, func, select

from kilter_service.contract.jobs.job import FINAL
from kilter_service.ground.db import Session
from kilter_service.ground.db.audited import note
from kilter_service.ground.db.tables import ActivationRow, FleetRobotRow, JobRow, VersionRow


def ended_before(session: Session, moment: datetime, most: int) -> list[str]:
    """Return the oldest jobs that were over before a moment and that nothing needs.

    Needed are the jobs of versions, their evaluations while a robot is corrected with them, the newest completed search of
    each robot, which says what is missing, all checks that were completed, which are a robot's history, and jobs of fleet
    jobs, which list them.
    """
    row = JobRow
    query = select(row.id).where(row.state.in_(FINAL), row.finished_at < moment, *_not_needed())
    return list(session.execute(query.order_by(row.finished_at, row.id).limit(most)).scalars())


def _not_needed() -> tuple[ColumnElement[bool], ...]:
    row, version = JobRow, JobRow.result["version_id"].as_string()
    last = select(func.max(ActivationRow.id)).group_by(ActivationRow.robot_id)
    active = select(ActivationRow.version_id).where(ActivationRow.id.in_(last))
    searched = (row.kind == "gap") & (row.state == "succeeded")
    later = select(func.max(row.created_at)).where(searched).group_by(row.robot_id)
    listed = select(FleetRobotRow.job_id).where(FleetRobotRow.job_id.is_not(None))
    return (
        row.id.not_in(select(VersionRow.job_id)),
        row.id.not_in(listed),
        ~((row.kind == "evaluate") & func.coalesce(version, "").in_(active)),
        ~((row.kind == "drift") & (row.state == "succeeded")),
        ~(searched & row.created_at.in_(later)),
    )


def remove(session: Session, ids: list[str]) -> None:
    """Delete jobs; the audit names each."""
    for job in ids:
        note(session, f"jobs/{job}", "kept", "purged")
    session.execute(delete(JobRow).where(JobRow.id.in_(ids)))
