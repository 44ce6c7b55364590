"""What a request must be before it is looked at: its name, its proxy, its size, and how slowly its head may come.

A page in a browser can send requests to any name, also to one that its own DNS points to this machine. It cannot choose the
Host header, the Origin header or what the browser says of the site it is from.

Connections of the API: a head that is sent too slowly is refused. uvicorn would wait for its end for ever.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import time
from collections.abc import Callable

from fastapi import FastAPI, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from kilter_service.ground.errors import PROBLEMS, ServiceError
from kilter_service.ground.settings import Settings, parse_name_list
from kilter_service.web.auth.access import OTHER_SITES, PLAIN_READS, address, is_loopback_name, parse_host_header
from kilter_service.web.auth.token import get_following
from kilter_service.web.problems import MEDIA_TYPE, problem
from kilter_service.web.request_log import new_request_id


class Gate:
    """Refuse requests that are not for this server, or not from where they may come."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._settings = app, settings
        self._names = {"localhost", settings.host.lower(), *parse_name_list(settings.hosts)}
        if not settings.is_loopback:
            self._names.add(socket.gethostname().lower())  # what `server.json` says

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "http":
            request = Request(scope)
            try:
                self._check(request)
            except ServiceError as error:
                await problem(request, error.code, error.message, error.context)(scope, receive, send)
                return
        await self.app(scope, receive, send)

    def _check(self, request: Request) -> None:
        self._check_peer("" if request.client is None else request.client.host)
        header = request.headers.get("host", "")
        self._check_host(parse_host_header(header))
        if request.method not in PLAIN_READS:
            _check_origin(request, header)

    def _check_peer(self, peer: str) -> None:
        if self._settings.proxy and not self._settings.trusts(peer) and not is_loopback_name(peer):
            raise ServiceError(
                f"This server is reached through its proxy only, and {peer or 'this peer'} is not it: send the request to "
                "the proxy, or add the address to KILTER_PROXY on the server.",
                code="proxy_only",
                peer=peer,
            )

    def _check_host(self, host: str) -> None:
        # An address was not looked up, so nobody's DNS can have pointed it here.
        if host not in self._names and address(host) is None:
            raise ServiceError(
                f"This server is not called {host[:100]!r}: use localhost, its address or one of its names, or add this one "
                "to KILTER_HOSTS on the server.",
                code="host_refused",
                host=host[:100],
            )


def _check_origin(request: Request, host: str) -> None:
    origin = request.headers.get("origin")
    site = request.headers.get("sec-fetch-site", "none")
    if site in OTHER_SITES or (origin is not None and origin.lower().partition("://")[2] != host.lower()):
        raise ServiceError(
            f"A page of another site ({(origin or site)[:100]}) may change nothing here: use the server's own /docs, "
            "`kilter` or the library. A proxy must pass on the Host header as it is.",
            code="origin_refused",
        )


BURST_S = 10.0  # what a sender has saved up after that many seconds of silence
MOST_SENDERS = 10_000


class Rates:
    """A bucket for each sender, which fills with time; every request takes one from it."""

    def __init__(self, per_second: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = per_second, clock
        self._full = max(1.0, per_second * BURST_S)
        self._buckets: dict[str, tuple[float, float]] = {}  # what is in it, and when that was

    def count_request(self, sender: str) -> None:
        """Count a request.

        Raises:
            ServiceError: the sender has asked too often; the context says when to ask again.

        """
        moment = self._clock()
        left = self._remaining_tokens(sender, moment)
        if left < 1.0:
            wait_s = max(1, math.ceil((1.0 - left) / self._rate))
            raise ServiceError(
                f"More than {self._rate:g} requests a second that compute or change something: send this one again in "
                f"{wait_s} s (KILTER_RATE on the server is the limit).",
                code="rate_limited",
                retry_after_s=wait_s,
            )
        if len(self._buckets) >= MOST_SENDERS and sender not in self._buckets:
            self._buckets = {
                name: was for name, was in self._buckets.items() if self._remaining_tokens(name, moment) < self._full
            }
        self._buckets[sender] = (left - 1.0, moment)

    def _remaining_tokens(self, sender: str, moment: float) -> float:
        left, since = self._buckets.get(sender, (self._full, moment))
        return min(self._full, left + (moment - since) * self._rate)


GRACE_S = 30.0  # of waiting, for any body
LEAST_BYTES_S = 10_000.0  # what a sender must reach on average after that


class Unhurried:
    """Count the time that is spent waiting for a body; that in which the server reads or computes does not count."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        await self.app(scope, _Body(receive).receive_message if scope["type"] == "http" else receive, send)


class _Body:
    def __init__(self, receive: Receive) -> None:
        self._receive, self._whole = receive, False
        self._waited, self._bytes = 0.0, 0

    async def receive_message(self) -> Message:
        """Return what comes next of a request.

        Raises:
            ServiceError: it did not come in time.

        """
        if self._whole:  # what follows is that the sender goes away, whenever it likes
            return await self._receive()
        clock = asyncio.get_running_loop().time
        since, allowed = clock(), GRACE_S + self._bytes / LEAST_BYTES_S
        try:
            async with asyncio.timeout(max(0.0, allowed - self._waited)):
                message = await self._receive()
        except TimeoutError as error:
            raise ServiceError(
                f"The request was not whole after {allowed:.0f} s of waiting; nothing was stored. Send it again over a faster "
                f"connection (at least {LEAST_BYTES_S / 1000:.0f} kB/s), a long recording in parts.",
                code="request_too_slow",
                retry_after_s=1,
            ) from error
        self._waited += clock() - since
        self._bytes += len(message.get("body", b""))
        self._whole = not message.get("more_body", False)
        return message


HEAD_S = 20.0
CODE = "request_too_slow"


class TimedConnection(H11Protocol):
    """A connection on which each request's head must be whole within ``HEAD_S`` of its first byte, or of connecting."""

    _timer: asyncio.TimerHandle | None = None
    _begun = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first head."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Read what came; wait for the rest of a head that is not whole yet."""
        self._begun = True
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._stop()
        super().connection_lost(exc)

    def _watch(self) -> None:
        answering = self.cycle is not None and not self.cycle.response_complete
        if answering or self.transport.is_closing():
            self._stop()
        elif self._timer is None:
            self._timer = self.loop.call_later(HEAD_S, self._refuse_late_head)

    def _stop(self) -> None:
        self._begun = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _refuse_late_head(self) -> None:
        self._timer = None
        if self.cycle is not None and not self.cycle.response_complete:
            return
        if self._begun and not self.transport.is_closing():
            self.transport.write(_refusal())
        self.transport.close()


def _refusal() -> bytes:
    status, title = PROBLEMS[CODE]
    document = {
        "type": f"urn:kilter:problem:{CODE}",
        "title": title,
        "status": status,
        "code": CODE,
        "context": {},
        "detail": f"The head of the request was not whole after {HEAD_S:g} s: send it again.",
        "request_id": new_request_id(),
    }
    body = json.dumps(document).encode()
    lines = [
        "HTTP/1.1 408 Request Timeout",
        f"Content-Type: {MEDIA_TYPE}",
        f"Content-Length: {len(body)}",
        "Retry-After: 1",
        "Connection: close",
    ]
    return "\r\n".join([*lines, "", ""]).encode() + body


class StreamEndingServer(Server):
    """A server that ends its streams of events when it stops. uvicorn waits for every open response, then cancels it."""

    def __init__(self, config: Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Let all followers go, then stop as uvicorn does."""
        get_following(self._app).stopping = True
        await super().shutdown(sockets)
