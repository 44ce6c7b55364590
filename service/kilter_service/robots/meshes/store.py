"""Meshes as they are stored, and their rows."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from sqlalchemy import select

from kilter_service.contract.robots import MeshUnit
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import MeshRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields


def put(session: Session, robot_id: int, record: MeshRecord, content: bytes) -> None:
    """Store the mesh of a link, in place of the one it has."""
    row = session.get(MeshRow, (robot_id, record.link))
    if row is None:
        row = MeshRow(robot_id=robot_id, link=record.link)
        session.add(row)
    row.format, row.unit, row.triangles = record.format, record.unit, record.triangles
    row.sha256, row.content, row.created_at = record.sha256, content, utc_now()
    session.flush()


def get(session: Session, robot_id: int, link: str) -> tuple[MeshRecord, bytes]:
    """Return the mesh of a link.

    Raises:
        ServiceError: it has none.

    """
    row = _row(session, robot_id, link)
    return _record(row), row.content


def remove(session: Session, robot_id: int, link: str) -> None:
    """Delete the mesh of a link."""
    session.delete(_row(session, robot_id, link))
    session.flush()


def meshes_of_robot(session: Session, robot_id: int) -> list[MeshRecord]:
    """Return the meshes of a robot."""
    columns = (MeshRow.link, MeshRow.format, MeshRow.unit, MeshRow.triangles, MeshRow.sha256, MeshRow.created_at)
    query = select(*columns).where(MeshRow.robot_id == robot_id).order_by(MeshRow.link)
    return [MeshRecord(*row) for row in session.execute(query)]  # type: ignore[arg-type]  # what was put there


def _row(session: Session, robot_id: int, link: str) -> MeshRow:
    row = session.get(MeshRow, (robot_id, link))
    if row is None:
        raise ServiceError(
            f"Link {link[:64]!r} has no mesh: GET /v1/robots/{{robot}}/meshes lists those that have one.",
            code="mesh_not_found",
            link=link,
        )
    return row


def _record(row: MeshRow) -> MeshRecord:
    return copy_fields(MeshRecord, row)


@dataclass(frozen=True)
class MeshRecord:
    """A mesh without its content."""

    link: str
    format: Literal["stl", "obj"]
    unit: MeshUnit
    triangles: int
    sha256: str
    created_at: datetime
