"""Versions as a job would store them, without one."""

from __future__ import annotations

from sqlalchemy import select

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion


def store_version(database: Database, robot: str, number: int) -> str:
    """Store the true Katana as version ``number`` of a robot; returns its id."""
    report = {"parameters": [], "metrics": {"train": {"n": 1}}, "noise_mm": 0.01}
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    document = thesis_katana().truth.to_document()
    new = NewVersion(document, report, {"names": [], "matrix": [], "units": "SI"}, [], limits, None, "test")
    with database.transaction() as session:
        robot_id = session.execute(select(RobotRow.id).where(RobotRow.name == robot)).scalar_one()
        job = f"job_{number:016x}"
        session.add(JobRow(id=job, kind="identify", robot_id=robot_id, request={}, state="succeeded"))
        session.flush()
        return store.add(session, robot_id, job, new)
