"""Around every request: its identifier, its line in the access log, its numbers, its span."""

from __future__ import annotations

import logging
import re
import time
import uuid

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics
from prometheus_client.gc_collector import GCCollector
from prometheus_client.process_collector import ProcessCollector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kilter_service.web import logs

# When a counter was made: twice the lines, and nobody asks for it.
disable_created_metrics()  # type: ignore[no-untyped-call]
REGISTRY = CollectorRegistry()
ProcessCollector(registry=REGISTRY)
GCCollector(registry=REGISTRY)

REQUESTS = Counter("kilter_http_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
DURATION = Histogram(
    "kilter_http_request_duration_seconds",
    "Time from the first byte of a request to the last of its answer.",
    ["method", "route"],
    buckets=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0),
    registry=REGISTRY,
)
OPEN = Gauge("kilter_http_requests_open", "Requests that are being answered.", registry=REGISTRY)
REFUSALS = Counter("kilter_refusals", "Requests refused, by error code.", ["code"], registry=REGISTRY)


access = logging.getLogger(logs.ACCESS)

# What a caller may name a request; anything else could not be told from the rest of a log line.
GIVEN = re.compile(r"[A-Za-z0-9._-]{1,64}")
HEADER = b"x-request-id"
NOSNIFF = (b"x-content-type-options", b"nosniff")  # what somebody uploaded is never taken for a page
UNKNOWN = "(none)"  # one name for all that no route takes, or whoever asks for random paths would fill the memory
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


def new_request_id() -> str:
    """Return the identifier that ties an answer to the logs."""
    return uuid.uuid4().hex[:16]


class Observed:
    """Watches what an application answers."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request_id = _request_id_from_header(scope) or new_request_id()
        scope.setdefault("state", {})["request_id"] = request_id
        answer = _Answer(send)
        began = time.perf_counter()
        OPEN.inc()
        try:
            with logs.about(request_id=request_id), logs.request(scope):
                await self.app(scope, receive, answer.send)
        finally:
            OPEN.dec()
            _note(scope, answer, time.perf_counter() - began, request_id)


class _Answer:
    """What was sent."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self.status = 499  # the caller went away before there was an answer
        self.bytes = 0

    async def send(self, message: Message) -> None:
        """Pass a message on and note it."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = message.get("headers", ())
            if not any(name.lower() == NOSNIFF[0] for name, _ in headers):
                message["headers"] = [*headers, NOSNIFF]
        else:
            self.bytes += len(message.get("body", b""))
        await self._send(message)


def _request_id_from_header(scope: Scope) -> str | None:
    for name, value in scope["headers"]:
        if name == HEADER:
            text = value.decode("latin-1")
            return text if GIVEN.fullmatch(text) else None
    return None


def _note(scope: Scope, answer: _Answer, seconds: float, request_id: str) -> None:
    route = getattr(scope.get("route"), "path", UNKNOWN)
    method = scope["method"] if scope["method"] in METHODS else UNKNOWN
    REQUESTS.labels(method, route, str(answer.status)).inc()
    DURATION.labels(method, route).observe(seconds)
    if not access.disabled:
        client = scope.get("client")
        access.info(
            "%s %s %d",
            scope["method"],
            scope["path"],
            answer.status,
            extra={
                "request_id": request_id,
                "client": client[0] if client else None,
                "actor": getattr(scope["state"].get("caller"), "actor", None),
                "duration_s": round(seconds, 6),
                "bytes": answer.bytes,
            },
        )
