"""Requests to a server as steps, separate from sending them.

A call is a generator: it yields a step, is given the answer, and returns what it read. Whoever runs it does the sending,
``Connection`` with threads and ``AsyncConnection`` under asyncio, so that what is asked and how answers are read is
written once.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, TypeVar
from urllib.parse import quote

from kilter_client.errors import ApiError, from_problem

T = TypeVar("T")

Document = dict[str, Any]
Sent = Callable[[int, int], None]

TIMEOUT_S = 60.0
# A busy server, and one that was asked too often, say after how many seconds to come again.
BUSY, BUSY_TRIES, LONGEST_WAIT_S = (408, 429, 503), 6, 60.0
PIECE = 1 << 18  # bytes of a body that are sent before the sender is told


@dataclass(frozen=True)
class Request:
    """A request to send; ``sent`` is told the bytes of ``content`` sent and their total."""

    method: str
    path: str
    params: Mapping[str, Any] | None = None
    body: Any = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    timeout_s: float = TIMEOUT_S
    sent: Sent | None = None

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


@dataclass(frozen=True)
class Pause:
    """Wait before the next step."""

    seconds: float


@dataclass(frozen=True)
class LookAgain:
    """Go on with the server that runs on this machine now, where it was found by its file there."""


@dataclass(frozen=True)
class Follow:
    """Follow a stream of events; ``told`` is given the document of each and answers whether that was enough."""

    path: str
    told: Callable[[Document], bool]


Step = Request | Pause | LookAgain | Follow
Steps: TypeAlias = Generator[Step, Any, T]


def address(*parts: str) -> str:
    """Return the path of a resource; names are quoted, whatever they hold."""
    return "/v1/" + "/".join(quote(part, safe="") for part in parts)


def answer_of(request: Request) -> Steps[Answer]:
    """Send a request; one that the server is too busy for is sent again after a while.

    Raises:
        ApiError: the server refuses; a subclass by the problem's code.

    """
    for left in reversed(range(BUSY_TRIES)):
        answer: Answer = yield request
        wait_s = answer.headers.get("retry-after", "")
        if answer.status not in BUSY or not wait_s.isdecimal() or not left:
            break
        yield Pause(min(float(wait_s), LONGEST_WAIT_S))
    refuse(answer.status, answer.content)
    return answer


def get(path: str, **params: Any) -> Steps[Document]:
    """Return the JSON document at ``path``."""
    return read(Request("GET", path, params=params))


def post(path: str, body: Mapping[str, Any] | None = None, headers: Mapping[str, str] | None = None) -> Steps[Document]:
    """Send a JSON document and return the answer's."""
    return read(Request("POST", path, body=body, headers=headers or {}))


def once() -> dict[str, str]:
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
    answer = yield from answer_of(request)
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
        yield from events.take(line)


class Events:
    """Server-sent events, line by line."""

    def __init__(self) -> None:
        self._data: list[str] = []

    def take(self, line: str) -> Iterator[Any]:
        """Yield the JSON of the event that ends with this line, if one does."""
        if line.startswith("data:"):
            self._data.append(line[5:].removeprefix(" "))
        elif not line and self._data:
            text, self._data = "\n".join(self._data), []
            try:
                yield json.loads(text)
            except ValueError:
                yield None
