"""Rows of logins."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import delete, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import LoginRow


def add(session: Session, sha256: str, token_sha256: str, expires_at: datetime) -> None:
    """Store a login by the hash of its secret."""
    session.add(LoginRow(sha256=sha256, token_sha256=token_sha256, expires_at=expires_at))


def login_token_hash(session: Session, sha256: str) -> str | None:
    """Return the hash of a login's token; None: there is no such login any more."""
    query = select(LoginRow.token_sha256).where(LoginRow.sha256 == sha256, LoginRow.expires_at > utc_now())
    return session.execute(query).scalar_one_or_none()


def consume_login(session: Session, sha256: str) -> str | None:
    """Delete a login and return the hash of its token; None: there is none any more, or somebody else took it."""
    row = LoginRow
    query = delete(row).where(row.sha256 == sha256, row.expires_at > utc_now()).returning(row.token_sha256)
    return session.execute(query).scalar_one_or_none()


def forget(session: Session, sha256: str) -> None:
    """Delete a login."""
    session.execute(delete(LoginRow).where(LoginRow.sha256 == sha256))


def forget_ended(session: Session) -> None:
    """Delete the logins that ended."""
    session.execute(delete(LoginRow).where(LoginRow.expires_at <= utc_now()))
