"""Rows of the processes that say they are alive."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from sqlalchemy import select

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import HeartbeatRow


class Heartbeat(NamedTuple):
    """A process and how long ago, in seconds, it said that it is alive; negative: in the future."""

    name: str
    age_s: float


def beat(
    session: Session, process: str, name: str, pid: int, details: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Say that a process ("worker", "corrector", "ros2") called ``name`` is alive now, and what it does."""
    session.merge(HeartbeatRow(process=process, name=name, pid=pid, at=utc_now(), details=dict(details)))


def silence(session: Session, process: str, name: str) -> None:
    """Say that a process has stopped."""
    row = session.get(HeartbeatRow, (process, name))
    if row is not None:
        session.delete(row)


def heartbeats(session: Session, process: str) -> list[Heartbeat]:
    """Return when the processes of a kind, which have not stopped by themselves, last said that they are alive."""
    rows = session.execute(select(HeartbeatRow).where(HeartbeatRow.process == process).order_by(HeartbeatRow.name))
    at = utc_now()
    return [Heartbeat(row.name, (at - row.at).total_seconds()) for row in rows.scalars()]
