"""Rows of the bridges that have announced themselves: they live beside those of the server's own processes."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import delete, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import HeartbeatRow

PROCESS = "bridge"


class Known(NamedTuple):
    """A bridge as it was heard last. ``details`` are the fields of the contract's news, and ``since``."""

    robot_id: int
    run: str
    heard_at: datetime
    silent_s: float
    details: dict[str, Any]


def note(session: Session, robot_id: int, run: str, details: Mapping[str, Any]) -> None:
    """Keep what a bridge says; ``since`` stays what it was at its first news."""
    name = f"{robot_id}/{run}"
    row, at = session.get(HeartbeatRow, (PROCESS, name)), utc_now()
    since = at.isoformat() if row is None else row.details["since"]
    told = {**details, "since": since}
    if row is None:
        session.add(HeartbeatRow(process=PROCESS, name=name, pid=0, at=at, details=told))
    else:
        row.at, row.details = at, told


def forget(session: Session, robot_id: int, longer_than_s: float, most: int) -> None:
    """Forget bridges, of any robot, that were not heard for so long, and of this one all but ``most``."""
    before = utc_now() - timedelta(seconds=longer_than_s)
    session.execute(delete(HeartbeatRow).where(HeartbeatRow.process == PROCESS, HeartbeatRow.at < before))
    rows = session.execute(
        select(HeartbeatRow).where(_bridge_condition(robot_id)).order_by(HeartbeatRow.at.desc()).offset(most)
    )
    for row in rows.scalars().all():
        session.delete(row)


def list_bridges(session: Session, robot_id: int | None = None) -> list[Known]:
    """Return the bridges of a robot, or of all; the newest first."""
    query = select(HeartbeatRow).where(
        HeartbeatRow.process == PROCESS if robot_id is None else _bridge_condition(robot_id)
    )
    at = utc_now()
    return [
        Known(*_place(row.name), row.at, (at - row.at).total_seconds(), row.details)
        for row in session.execute(query.order_by(HeartbeatRow.at.desc())).scalars()
    ]


def _place(name: str) -> tuple[int, str]:
    robot_id, _, run = name.partition("/")
    return int(robot_id), run


def _bridge_condition(robot_id: int) -> Any:
    return (HeartbeatRow.process == PROCESS) & HeartbeatRow.name.startswith(f"{robot_id}/", autoescape=True)
