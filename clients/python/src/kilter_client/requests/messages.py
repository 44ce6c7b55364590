"""A request and its answer, as they go over the wire."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

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
