"""What can be done with tokens."""

from __future__ import annotations

import hashlib
import logging
import secrets
from datetime import timedelta

from kilter_service.contract.health import MadeToken, NewToken, Token, TokenList
from kilter_service.ground.caller import ADMIN, ANYBODY
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, in_time
from kilter_service.web import store

log = logging.getLogger("kilter.api")

PREFIX = "kilter_"  # programs that look for secrets in published files know them by it
SECRET_BYTES = 32


def add(database: Database, wanted: NewToken, actor: str) -> MadeToken:
    """Make a token; its secret is in the answer and nowhere else.

    Raises:
        ServiceError: the name is taken, or is one of Kilter's own.

    """
    if wanted.name in (ADMIN, ANYBODY):
        raise ServiceError(
            f"{wanted.name!r} is how the records call the server's own token or none: give another name.",
            code="name_invalid",
            name=wanted.name,
        )
    secret = PREFIX + secrets.token_urlsafe(SECRET_BYTES)
    expires = None if wanted.days is None else utc_now() + timedelta(days=wanted.days)
    with database.transaction() as session:
        made = store.add(session, hash_secret(secret), wanted.name, wanted.role, wanted.robots, expires, actor)
    return MadeToken(**made.model_dump(), token=secret)


def list_tokens(database: Database, page: Page) -> TokenList:
    """List the tokens, those that ended too."""
    with database.reading() as session:
        found = store.tokens_on_page(session, page)
    shown, cursor = page.cut(found, lambda token: in_time(token.created_at, token.id))
    return TokenList(tokens=list(shown), next=cursor)


def revoke(database: Database, token_id: str, actor: str) -> Token:
    """End a token at once."""
    with database.transaction() as session:
        return store.revoke(session, token_id, actor)


def get_valid_token(database: Database, sha256: str) -> Token:
    """Return the token whose secret has this hash, if it still holds.

    Raises:
        ServiceError: there is none, it has expired, it was revoked, or it is not what the audit says of it.

    """
    with database.reading() as session:
        found = store.by_hash(session, sha256)
        altered = "" if found is None else database.audited_tokens.describe_difference(session, found.id)
    if found is None:
        raise ServiceError(
            "The token is not one of this server's: compare it with the `token` file in the server's data folder, or ask "
            "an admin for a new one (`kilter server token add`).",
            code="token_wrong",
        )
    if found.revoked_at is not None or (found.expires_at is not None and found.expires_at <= utc_now()):
        ended = f"was revoked by {found.revoked_by}" if found.revoked_at else "has expired"
        raise ServiceError(
            f"Token {found.name!r} {ended}: ask an admin for a new one (`kilter server token add`).",
            code="token_ended",
            name=found.name,
        )
    if altered:
        log.error("token %s does not work, it was altered past Kilter: %s Run `kilterd verify`.", found.id, altered)
        raise ServiceError(
            f"Token {found.name!r} was altered past Kilter: ask an admin for a new one (`kilter server token add`).",
            code="token_ended",
            name=found.name,
        )
    return found


def hash_secret(secret: str) -> str:
    """Return what is stored of a secret. It has 256 random bits, so that a plain hash cannot be searched backwards."""
    return hashlib.sha256(secret.encode()).hexdigest()
