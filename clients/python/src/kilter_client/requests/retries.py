"""When a request is sent again, and after how long."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from typing import TYPE_CHECKING

from kilter_client.errors import ServerUnreachableError

if TYPE_CHECKING:
    from kilter_client.requests.messages import Answer, Request

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
