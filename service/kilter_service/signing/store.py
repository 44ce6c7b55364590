"""Which sessions of streams a token asked for. The audit has them, and nothing else."""

from __future__ import annotations

import json

from sqlalchemy import select

from kilter_service.db import Session
from kilter_service.db.tables import AuditRow

THING = "stream session"


def sessions_of(session: Session, token_id: str) -> list[bytes]:
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
