"""Connections of the API: a head that is sent too slowly is refused. uvicorn would wait for its end for ever."""

from __future__ import annotations

import asyncio
import json
import socket

from fastapi import FastAPI
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from kilter_service.ground.errors import PROBLEMS
from kilter_service.web.auth.following import get_following
from kilter_service.web.observability.requests import new_request_id
from kilter_service.web.problems import MEDIA_TYPE

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
