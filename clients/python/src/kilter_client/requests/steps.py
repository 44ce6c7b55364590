"""Requests to a server as steps, separate from sending them.

A call is a generator: it yields a step, is given the answer, and returns what it read. Whoever runs it does the sending,
``Connection`` with threads and ``AsyncConnection`` under asyncio, so that what is asked and how answers are read is
written once.
"""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, TypeVar
from urllib.parse import quote

from kilter_client.errors import ApiError, KilterError, ServerUnreachableError, from_problem

Sent = Callable[[int, int], None]

TIMEOUT_S = 60.0
PIECE = 1 << 18  # bytes of a body that are sent before the sender is told


@dataclass(frozen=True)
class Request:
    """A request to send; ``sent`` is told the bytes of ``content`` sent and their total.

    ``again`` says of a change without a key that it does the same sent twice as sent once.
    """

    method: str
    path: str
    params: Mapping[str, Any] | None = None
    body: Any = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    timeout_s: float = TIMEOUT_S
    sent: Sent | None = None
    again: bool = False
    patience_s: float | None = None  # None: that of ``again``

    def pieces(self) -> Iterator[bytes]:
        """Yield the content piece by piece; what was sent is told after each."""
        content = self.content or b""
        for start in range(0, len(content), PIECE):
            piece = content[start : start + PIECE]
            yield piece
            if self.sent is not None:
                self.sent(start + len(piece), len(content))


@dataclass(frozen=True)
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    content: bytes
    url: str


# A server whose process was killed answers again within seconds. Waits after lost connections add up to no more than this.
PATIENCE_S = 30.0
FIRST_WAIT_S, LONGEST_WAIT_S = 0.2, 5.0
# A busy server, and one that was asked too often, say after how many seconds to come again.
BUSY, BUSY_TRIES, LONGEST_BUSY_S = (408, 429, 503), 6, 60.0
AWAY = (502, 504)  # what a proxy says while the server behind it starts
READS = ("GET", "HEAD")


class RetryPolicy:
    """The waits of one request: each about twice the one before, and no two clients wait alike."""

    def __init__(self, patience_s: float | None = None) -> None:
        self._left_s = PATIENCE_S if patience_s is None else patience_s
        self._next_s, self._busy = FIRST_WAIT_S, BUSY_TRIES - 1

    def after_loss(self, request: Request, error: ServerUnreachableError) -> float | None:
        """Return how long to wait after a connection failed; None: the request is not sent again."""
        return self._consume_wait_s() if error.lost and (error.unsent or repeatable(request)) else None

    def _consume_wait_s(self) -> float | None:
        if self._left_s <= 0:
            return None
        wait_s = min(self._grown(), self._left_s)
        self._left_s -= wait_s
        return wait_s

    def wait_after_answer(self, request: Request, answer: Answer) -> float | None:
        """Return how long to wait after an answer; None: it is the last word."""
        if answer.status in AWAY:
            return self._consume_wait_s() if repeatable(request) else None
        told = answer.headers.get("retry-after", "")
        if answer.status not in BUSY or not told.isdecimal() or not self._busy:
            return None
        if not repeatable(request) and not _has_changed_nothing(answer):
            return None
        self._busy -= 1
        return min(float(told), LONGEST_BUSY_S) + self._grown()

    def _grown(self) -> float:
        wait_s = self._next_s * random.uniform(0.5, 1.0)  # noqa: S311 (no secret: so that clients do not come at once)
        self._next_s = min(2 * self._next_s, LONGEST_WAIT_S)
        return wait_s


def repeatable(request: Request) -> bool:
    """Whether a request does the same sent twice as sent once: it reads, or the server knows it by its key."""
    return request.method in READS or request.again or "Idempotency-Key" in request.headers


def _has_changed_nothing(answer: Answer) -> bool:
    """Whether a refusal says that nothing was begun; one because the database is away can come after the change."""
    return answer.status != 503 or _code(answer.content) == "busy"


def _code(content: bytes) -> str | None:
    try:
        problem = json.loads(content)
    except ValueError:
        return None
    return problem.get("code") if isinstance(problem, Mapping) else None


T = TypeVar("T")

Document = dict[str, Any]
REQUEST_ID = "X-Request-ID"


@dataclass(frozen=True)
class Pause:
    """Wait before the next step."""

    seconds: float


@dataclass(frozen=True)
class Relocate:
    """Go on with the server that runs on this machine now, where it was found by its file there."""


@dataclass(frozen=True)
class Follow:
    """Follow a stream of events; ``on_event`` is given the document of each and answers whether that was enough.

    Done again after a break it goes on behind the last event that ``events`` has read.
    """

    path: str
    on_event: Callable[[Document], bool]
    events: Events = field(default_factory=lambda: Events())
    request_id: str = field(default_factory=lambda: new_request_id())

    def headers(self) -> dict[str, str]:
        """Return what to send with the request."""
        last = {"Last-Event-ID": self.events.last_id} if self.events.last_id else {}
        return {"Accept": "text/event-stream", REQUEST_ID: self.request_id} | last


Step = Request | Pause | Relocate | Follow
Steps: TypeAlias = Generator[Step, Any, T]


def address(*parts: str) -> str:
    """Return the path of a resource; names are quoted, whatever they hold."""
    return "/v1/" + "/".join(quote(part, safe="") for part in parts)


def new_request_id() -> str:
    """Return an identifier for a request, by which the server's log and an error name it."""
    return os.urandom(8).hex()


def send_with_retries(request: Request) -> Steps[Answer]:
    """Send a request. It is sent again when the server is busy, or when its connection was lost and that does no harm.

    All that is sent of one request has one ``X-Request-ID``, which errors name.

    Raises:
        ApiError: the server refuses; a subclass by the problem's code.
        ServerUnreachableError: no answer.

    """
    request_id = request.headers.get(REQUEST_ID) or new_request_id()
    request = replace(request, headers={**request.headers, REQUEST_ID: request_id})
    waits = RetryPolicy(request.patience_s)
    try:
        while True:
            try:
                answer: Answer = yield request
            except ServerUnreachableError as error:
                wait_s = waits.after_loss(request, error)
                if wait_s is None:
                    raise
            else:
                wait_s = waits.wait_after_answer(request, answer)
                if wait_s is None:
                    refuse(answer.status, answer.content)
                    return answer
            yield Pause(wait_s)
            yield Relocate()
    except KilterError as error:
        error.request_id = error.request_id or request_id
        raise


def get(path: str, **params: Any) -> Steps[Document]:
    """Return the JSON document at ``path``; a parameter that is None is not sent."""
    return read(Request("GET", path, params={name: value for name, value in params.items() if value is not None}))


def post(
    path: str, body: Mapping[str, Any] | None = None, headers: Mapping[str, str] | None = None, again: bool = False
) -> Steps[Document]:
    """Send a JSON document and return the answer's; ``again`` as in ``Request``."""
    return read(Request("POST", path, body=body, headers=headers or {}, again=again))


def idempotency_header() -> dict[str, str]:
    """Return a header by which the server knows a request that is sent again, and does it once."""
    return {"Idempotency-Key": os.urandom(16).hex()}


def patch(path: str, body: Mapping[str, Any]) -> Steps[Document]:
    """Send what shall change as a JSON document and return the answer's."""
    return read(Request("PATCH", path, body=body))


def read(request: Request) -> Steps[Document]:
    """Send a request and return the JSON object it is answered with.

    Raises:
        ApiError: it holds something else, so this is not a Kilter server.

    """
    answer = yield from send_with_retries(request)
    try:
        found = json.loads(answer.content)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise ApiError(
            f"{answer.url} answered something that is not a JSON object: is KILTER_URL a Kilter server?",
            status=answer.status,
        )
    return found


def refuse(status: int, content: bytes) -> None:
    """Raise what an answer of this status says, if it refuses."""
    if status < 400:
        return
    try:
        problem = json.loads(content)
    except ValueError:
        problem = {}
    raise from_problem(problem if isinstance(problem, dict) else {}, status)


def event_data(lines: Iterator[str]) -> Iterator[Any]:
    """Yield the JSON of each server-sent event; comments are passed over, an event without JSON is None."""
    events = Events()
    for line in lines:
        yield from events.parse_event_line(line)


class Events:
    """Server-sent events, line by line, and the id of the last one that was whole."""

    def __init__(self) -> None:
        self.last_id = ""
        self._id = ""
        self._data: list[str] = []

    def discard_partial_event(self) -> None:
        """Forget the beginning of an event that a break has cut."""
        self._id, self._data = self.last_id, []

    def parse_event_line(self, line: str) -> Iterator[Any]:
        """Yield the JSON of the event that ends with this line, if one does."""
        if line.startswith("data:"):
            self._data.append(line[5:].removeprefix(" "))
        elif line.startswith("id:"):
            self._id = line[3:].removeprefix(" ")
        elif not line and self._data:
            text, self._data, self.last_id = "\n".join(self._data), [], self._id
            try:
                yield json.loads(text)
            except ValueError:
                yield None
