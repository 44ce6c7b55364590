"""Rows of the processes that say they are alive."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import func, select

from kilter_service.db import Session
from kilter_service.db.tables import HeartbeatRow, now


def beat(session: Session, process: str, name: str, pid: int) -> None:
    """Say that a process ("worker", "corrector") called ``name`` is alive now."""
    session.merge(HeartbeatRow(process=process, name=name, pid=pid, at=now()))


def silence(session: Session, process: str, name: str) -> None:
    """Say that a process has stopped."""
    row = session.get(HeartbeatRow, (process, name))
    if row is not None:
        session.delete(row)


def alive(session: Session, process: str, within_s: float) -> int:
    """Return how many processes of a kind said so within the last seconds."""
    since = now() - timedelta(seconds=within_s)
    query = select(func.count()).where(HeartbeatRow.process == process, HeartbeatRow.at >= since)
    return session.execute(query).scalar_one()
