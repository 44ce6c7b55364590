"""The first answers of requests, stored with what they did."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

from sqlalchemy import delete

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import AnsweredRow

KEPT_FOR = timedelta(days=7)


def answer(session: Session, key_id: str) -> tuple[str, dict[str, Any]] | None:
    """Return the hash of the first body that came under a key, and what it was answered with."""
    row = session.get(AnsweredRow, key_id)
    return None if row is None else (row.body_sha256, row.answer)


def keep(session: Session, key_id: str, body_sha256: str, document: dict[str, Any]) -> None:
    """Keep the answer of a request that is done in this transaction; forget those of long ago."""
    session.execute(delete(AnsweredRow).where(AnsweredRow.at < utc_now() - KEPT_FOR))
    session.add(AnsweredRow(id=key_id, body_sha256=body_sha256, answer=document))
    session.flush()
