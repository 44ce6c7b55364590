"""Who follows events: not more at a time than is sensible, and not longer than the token or the login holds."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager

from fastapi import FastAPI, Request
from fastapi.concurrency import run_in_threadpool

from kilter_service.ground.caller import ANYBODY
from kilter_service.ground.errors import ServiceError
from kilter_service.web import logins, tokens
from kilter_service.web.auth.access import Credentials, get_caller

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
        if sha256 is not None and sha256 != tokens.hash_secret(request.app.state.token):
            tokens.get_valid_token(database, sha256)
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
