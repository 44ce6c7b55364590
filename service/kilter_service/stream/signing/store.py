"""Which sessions of streams a token asked for. The audit has them, and nothing else."""

from __future__ import annotations

import json
import time
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import AuditRow

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
