"""Rows of bridges that announced themselves, sessions of streams that were asked for, and the streams of a robot.

Which sessions of streams a token asked for. The audit has them, and nothing else.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any, NamedTuple

from sqlalchemy import delete, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import AuditRow, HeartbeatRow
from kilter_service.robots import store as robots
from kilter_service.robots.compensation import objection
from kilter_service.versions import store as versions
from kilter_service.web import store as health

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


THING = "stream session"


class Holder(NamedTuple):
    """A session that has not ended, and who asked for it when."""

    session: bytes
    actor: str
    token_id: str
    since: datetime


def holders(session: Session, robot: str, stream: str) -> list[Holder]:
    """Return the sessions of a stream that have not ended by themselves; some may have been revoked."""
    content = AuditRow.content
    query = select(content).where(content.contains(f'"{THING}"')).order_by(AuditRow.number)
    found = []
    for text in session.execute(query).scalars():
        entry = json.loads(text)
        for said in (json.loads(one["after"]) for one in entry["changes"] if one["thing"] == THING):
            lasts = datetime.fromisoformat(said["until"]).timestamp() > time.time()
            if lasts and (said["robot"], said["stream"]) == (robot, stream):
                at = datetime.fromisoformat(entry["at"])
                found.append(Holder(bytes.fromhex(said["session"]), entry["actor"], entry["token_id"], at))
    return found


def sessions_of_token(session: Session, token_id: str) -> list[bytes]:
    """Return the ids of the sessions that a token asked for, also of those that have ended."""
    content = AuditRow.content
    query = select(content).where(content.contains(f'"token_id": "{token_id}"'), content.contains(f'"{THING}"'))
    found = []
    for text in session.execute(query).scalars():
        entry = json.loads(text)
        if entry["token_id"] == token_id:
            said = [json.loads(one["after"]) for one in entry["changes"] if one["thing"] == THING]
            found += [bytes.fromhex(one["session"]) for one in said]
    return found


class KnownStreams(NamedTuple):
    """The active version, whether some corrector says that it is alive, and what it last said of the robot's streams.

    ``twice`` says that the controller corrects by itself, so that the corrector does not; empty where it does not.
    """

    active_version: str | None = None
    alive: bool = False
    reports: tuple[dict[str, Any], ...] = ()
    twice: str = ""


def load_robot_state(session: Session, robot: str, within_s: float) -> KnownStreams:
    """Look up a robot."""
    stored = robots.get(session, robot)
    active, twice = versions.active_entry(session, stored.id), objection(robot, stored.controller_compensation)
    alive = any(abs(beat.age_s) < within_s for beat in health.heartbeats(session, "corrector"))
    told = tuple(report for report in health.streams(session) if report["robot"] == robot) if alive else ()
    return KnownStreams(
        None if active is None else active.version_id, alive, told, "" if twice is None else twice.message
    )
