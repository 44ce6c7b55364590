"""Who is logged in at the page, and what can be done with tokens.

A browser keeps a secret in a cookie that no script reads and no other site sends; the database keeps its hash, and that of
the token that was given. The login ends with the token, or after some hours.
"""

from __future__ import annotations

import hashlib
import logging
import secrets
from datetime import datetime, timedelta

from kilter_service.contract.server import MadeToken, NewToken, Token, TokenList
from kilter_service.ground.caller import ADMIN, ANYBODY
from kilter_service.ground.db import Database, audited
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, in_time
from kilter_service.web import store

log = logging.getLogger("kilter.api")

PREFIX = "kilter_"  # programs that look for secrets in published files know them by it


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


COOKIE = "kilter_login"
CSRF_HEADER = "X-CSRF-Token"
HOURS = 12
SECRET_BYTES = 32


def create_login(database: Database, token_sha256: str) -> str:
    """Keep a login with a token that holds; returns the secret for the browser. Logins that ended are deleted."""
    secret = secrets.token_urlsafe(SECRET_BYTES)
    until = utc_now() + timedelta(hours=HOURS)
    with database.transaction() as session:
        store.forget_ended(session)
        store.add_login(session, hash_secret(secret), token_sha256, until)
        audited.note(session, "login", None, {"until": until.isoformat()})
    return secret


def link(database: Database, token_sha256: str, minutes: int) -> tuple[str, datetime]:
    """Keep a login that a browser may begin once; returns the secret of its link, and until when that holds."""
    secret = secrets.token_urlsafe(SECRET_BYTES)
    until = utc_now() + timedelta(minutes=minutes)
    with database.transaction() as session:
        store.forget_ended(session)
        store.add_login(session, _stored_link_key(secret), token_sha256, until)
        audited.note(session, "login_link", None, {"until": until.isoformat()})
    return secret, until


def take_link(database: Database, secret: str) -> str:
    """Use up a link; returns the hash of the token that it stands for.

    Raises:
        ServiceError: it was used, it is too old, or it never was.

    """
    with database.transaction() as session:
        found = store.consume_login(session, _stored_link_key(secret))
    if found is None:
        raise ServiceError(
            "This link was used already or is too old: print a new one with `kilter server login`, or log in with your token.",
            code="token_ended",
        )
    return found


def _stored_link_key(secret: str) -> str:
    """What is stored of a link: never the hash of a cookie, so a link is not a login before it is used up."""
    return f"link{hash_secret(secret)[:60]}"


def log_out(database: Database, secret: str) -> None:
    """End a login; nothing happens when it has ended already."""
    with database.transaction() as session:
        store.forget(session, hash_secret(secret))


def login_token_hash(database: Database, secret: str) -> str | None:
    """Return the hash of the token that a browser logged in with; None: it did not, or its login has ended."""
    with database.reading() as session:
        return store.login_token_hash(session, hash_secret(secret))


def csrf_token(secret: str) -> str:
    """Return what the page sends with every change; another site can neither read nor compute it."""
    return hashlib.blake2s(b"csrf", key=secret.encode()[:32]).hexdigest()


def check_csrf(secret: str, given: str) -> None:
    """Refuse a change that was not sent by the page itself.

    Raises:
        ServiceError: the header is missing or of another login.

    """
    if not secrets.compare_digest(csrf_token(secret).encode(), given.encode()):
        raise ServiceError(
            f"A change by somebody who is logged in needs the header {CSRF_HEADER} that the page sends: load the page anew "
            "and try again. Programs send `Authorization: Bearer ...` and no cookie.",
            code="csrf_missing",
        )
