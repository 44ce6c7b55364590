"""Who is logged in at the page.

A browser keeps a secret in a cookie that no script reads and no other site sends; the database keeps its hash, and that of
the token that was given. The login ends with the token, or after some hours.
"""

from __future__ import annotations

import hashlib
import secrets
from datetime import datetime, timedelta

from kilter_service.ground.db import Database, audited
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.web import store
from kilter_service.web.tokens import hash_secret

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
