"""Tokens as they are stored, of the secret only its hash, and their rows."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import and_, or_, select

from kilter_service.contract.tokens import Role, Token
from kilter_service.ground.by_name import copy_fields
from kilter_service.ground.caller import CALLER
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import TokenRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page


def add(
    session: Session,
    sha256: str,
    name: str,
    role: Role,
    robots: Sequence[str] | None,
    expires_at: datetime | None,
    actor: str,
) -> Token:
    """Store a new token by the hash of its secret.

    Raises:
        ServiceError: another one that still works has the name.

    """
    taken = select(TokenRow).where(TokenRow.name == name, TokenRow.revoked_at.is_(None))
    for other in session.execute(taken).scalars():
        if other.expires_at is None or other.expires_at > utc_now():
            raise ServiceError(
                f"There is a token called {name!r} already, {other.id}: give another name, or revoke that one "
                f"(kilter server token revoke {other.id}).",
                code="name_taken",
                name=name,
                id=other.id,
            )
    row = TokenRow(
        id=f"tok_{uuid.uuid4().hex[:16]}",
        name=name,
        sha256=sha256,
        role=role,
        robots=None if robots is None else sorted(set(robots)),
        created_by=actor,
        expires_at=expires_at,
    )
    session.add(row)
    session.flush()
    return copy_fields(Token, row)


def by_hash(session: Session, sha256: str) -> Token | None:
    """Return the token whose secret has this hash."""
    row = session.execute(select(TokenRow).where(TokenRow.sha256 == sha256)).scalar_one_or_none()
    return None if row is None else copy_fields(Token, row)


def tokens_on_page(session: Session, page: Page) -> list[Token]:
    """Return tokens, newest first, one more than the page shows; those that ended too."""
    row = TokenRow
    query = select(row).order_by(row.created_at.desc(), row.id)
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(or_(row.created_at < moment, and_(row.created_at == moment, row.id > key)))
    return [copy_fields(Token, found) for found in session.execute(query.limit(page.fetch_limit)).scalars()]


def revoke(session: Session, token_id: str, actor: str) -> Token:
    """End a token; nothing changes when it was revoked already.

    Raises:
        ServiceError: there is none.

    """
    row = session.get(TokenRow, token_id)
    if row is None:
        raise ServiceError(
            f"There is no token {token_id!r}: list them with `kilter server token list`.",
            code="token_not_found",
            id=token_id,
        )
    if row.revoked_at is None:
        row.revoked_at, row.revoked_by = utc_now(), actor
        session.flush()
    return copy_fields(Token, row)


def left_s(session: Session) -> float:
    """Return how long the token of the caller holds, s; infinite for the server's own.

    Raises:
        ServiceError: it has ended since the request was let in.

    """
    caller = CALLER.get()
    row = None if caller is None or not caller.token_id else session.get(TokenRow, caller.token_id)
    if row is None:
        return float("inf")
    left = float("inf") if row.expires_at is None else (row.expires_at - utc_now()).total_seconds()
    if row.revoked_at is not None or left <= 0.0:
        raise ServiceError(
            f"Token {row.name!r} has ended: ask an admin for a new one.", code="token_ended", name=row.name
        )
    return left
