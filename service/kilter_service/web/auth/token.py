"""The admin token, made at first start and kept in a file only its owner can read; where a server listens by it.

Who follows events: not more at a time than is sensible, and not longer than the token or the login holds.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import ssl
import stat
import time
from collections import Counter
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager

from fastapi import FastAPI, Request
from fastapi.concurrency import run_in_threadpool

from kilter_service.ground.caller import ANYBODY
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings, check_strong
from kilter_service.web import logins
from kilter_service.web.auth.access import Credentials, get_caller


def admin_token(settings: Settings) -> str:
    """Return the token that changes need; the first start of a data folder makes it (mode 0600).

    Raises:
        ServiceError: the token file can be read by others, or holds a token that can be guessed.

    """
    if settings.token is not None:
        return settings.token.get_secret_value()
    settings.data.mkdir(parents=True, exist_ok=True)
    # Two processes may start at once: whoever links the finished file first wins, the other reads it.
    if not settings.token_file.exists():
        _offer(settings)
    if stat.S_IMODE(settings.token_file.stat().st_mode) & 0o077:
        raise ServiceError(
            f"{settings.token_file} can be read by others: run `chmod 600 {settings.token_file}`.",
            code="token_file_open",
            path=str(settings.token_file),
        )
    token = settings.token_file.read_text(encoding="ascii", errors="replace").strip()
    try:
        check_strong(token)
    except ValueError as error:
        raise ServiceError(
            f"In {settings.token_file} {error}, or delete the file: the next start makes a new one.",
            code="token_weak",
            path=str(settings.token_file),
        ) from error
    return token


def _offer(settings: Settings) -> None:
    draft = settings.token_file.with_name(f"{settings.token_file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_urlsafe(32) + "\n")
    try:
        os.link(draft, settings.token_file)
    except FileExistsError:
        return
    finally:
        draft.unlink()


def check_binding(settings: Settings) -> None:
    """Refuse to listen beyond this machine without a token, or without TLS.

    Raises:
        ServiceError: so, or a certificate that cannot be used.

    """
    check_certificate(settings)
    if settings.is_loopback:
        return
    if settings.token is None and not settings.token_file.exists():
        raise _binding_error(settings, "no token is configured: set KILTER_TOKEN, or listen on 127.0.0.1")
    if settings.tls_certificate is None and not settings.proxy:
        raise _binding_error(
            settings,
            "tokens would travel in the clear: set KILTER_TLS_CERTIFICATE and KILTER_TLS_KEY, or put a proxy with TLS in "
            "front and set KILTER_PROXY to its address, or listen on 127.0.0.1",
        )


def _binding_error(settings: Settings, why: str) -> ServiceError:
    return ServiceError(
        f"{settings.host} can be reached from other machines and {why}.", code="binding_refused", host=settings.host
    )


def check_certificate(settings: Settings) -> None:
    """Refuse a certificate without its key, or one that cannot be read.

    Raises:
        ServiceError: so.

    """
    if settings.tls_certificate is None and settings.tls_key is None:
        return
    if settings.tls_certificate is None or settings.tls_key is None:
        raise ServiceError("Set both KILTER_TLS_CERTIFICATE and KILTER_TLS_KEY, or neither.", code="binding_refused")
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(settings.tls_certificate, settings.tls_key)
    except (OSError, ssl.SSLError) as error:
        raise ServiceError(
            f"{settings.tls_certificate} and {settings.tls_key} cannot be used for TLS ({error}): give the PEM files of "
            "a certificate and of its key, without a password, readable by this account.",
            code="binding_refused",
        ) from error


MOST = 64  # that one token, or one address without a token, follows at a time
CHECK_S = 0.4
ENDED = 'event: refused\ndata: {"code": "token_ended"}\n\n'  # whoever comes again is told why

Events = AsyncGenerator[str, None]


class Following:
    """All who follow events in this process."""

    def __init__(self) -> None:
        self.open: Counter[str] = Counter()
        self.stopping = False  # the server: whoever follows is let go and comes again
        self._looked: dict[Credentials, tuple[float, bool]] = {}

    @contextmanager
    def register_follower(self, sender: str) -> Iterator[None]:
        """Count a follower in, and out again."""
        self.open[sender] += 1
        try:
            yield
        finally:
            self.open[sender] -= 1
            if not self.open[sender]:
                del self.open[sender]
            if not self.open:
                self._looked.clear()

    async def holds(self, request: Request) -> bool:
        """Whether what a request was let in with still holds; however many follow with it, it is looked up once."""
        shown: Credentials = request.state.credentials
        if shown.token_sha256 is None:
            return True
        now_s = time.monotonic()
        looked_s, held = self._looked.get(shown, (-CHECK_S, True))
        if now_s - looked_s < CHECK_S:
            return held
        self._looked[shown] = now_s, held  # the others need not look while this one does
        held = await run_in_threadpool(_holds, request, shown)
        self._looked[shown] = now_s, held
        return held


def _holds(request: Request, shown: Credentials) -> bool:
    database, sha256 = request.app.state.database, shown.token_sha256
    try:
        if shown.login and logins.login_token_hash(database, shown.login) is None:
            return False
        if sha256 is not None and sha256 != logins.hash_secret(request.app.state.token):
            logins.get_valid_token(database, sha256)
    except ServiceError as error:
        return error.code not in ("token_ended", "token_wrong")
    except Exception:  # the database may be away for a while; who was let in before stays
        return True
    return True


def limit_event_stream(request: Request, events: Events) -> Events:
    """Yield events to whoever sends a request, as long as that may be.

    Raises:
        ServiceError: the same token follows as much as one may.

    """
    following, caller = get_following(request.app), get_caller(request)
    sender = f"address {caller.address}" if caller.actor == ANYBODY else caller.token_id or caller.actor
    if following.open[sender] >= MOST:
        raise ServiceError(
            f"{MOST} streams of events are open with this token already: end some, or ask for the state of jobs now and "
            "then (GET /v1/jobs).",
            code="too_many_followers",
            most=MOST,
            retry_after_s=5,
        )
    return _while_it_holds(request, following, sender, events)


async def _while_it_holds(request: Request, following: Following, sender: str, events: Events) -> Events:
    with following.register_follower(sender):
        if following.open[sender] > MOST:  # many came at once
            return
        coming = asyncio.ensure_future(anext(events, None))
        try:
            while not following.stopping and await following.holds(request):
                await asyncio.wait({coming}, timeout=CHECK_S)
                if not coming.done():
                    continue
                event = coming.result()
                if event is None:
                    return
                yield event
                coming = asyncio.ensure_future(anext(events, None))
            if not following.stopping:
                yield ENDED
        finally:
            coming.cancel()
            await asyncio.wait({coming})
            await events.aclose()


def get_following(app: FastAPI) -> Following:
    """Return who follows events of an application."""
    if not hasattr(app.state, "following"):
        app.state.following = Following()
    found: Following = app.state.following
    return found
