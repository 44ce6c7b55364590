"""What a stream gives back: a setpoint that says where it comes from, and the statistics of all of them."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

From = Literal["corrected", "held", "bypass"]


class Setpoint(tuple[float, ...]):
    """Joints to send to the arm, and where they come from."""

    source: From
    status: str | None  # the corrector's verdict; None when no answer came in time
    wanted: tuple[float, ...]
    flags: int
    round_trip_s: float | None

    def __new__(
        cls,
        q: Iterable[float],
        *,
        source: From,
        wanted: tuple[float, ...],
        status: str | None = None,
        flags: int = 0,
        round_trip_s: float | None = None,
    ) -> Setpoint:
        """Make a setpoint of ``q``."""
        made = super().__new__(cls, q)
        made.source, made.status, made.wanted, made.flags, made.round_trip_s = (
            source,
            status,
            wanted,
            flags,
            round_trip_s,
        )
        return made

    @property
    def delta(self) -> tuple[float, ...]:
        """The correction of each joint."""
        return tuple(a - b for a, b in zip(self, self.wanted, strict=True))


@dataclass
class Statistics:
    """What happened to the setpoints of a stream."""

    sent: int = 0
    corrected: int = 0
    held: int = 0
    bypassed: int = 0
    missed: int = 0  # no answer within the deadline
    late: int = 0  # answers dropped because their cycle was over
    unknown_epoch: int = 0
    malformed: int = 0
    forged: int = 0  # dropped: not signed with the key in use
    foreign: int = 0  # dropped: they do not echo a setpoint of this stream
    too_large: int = 0  # dropped: beyond the largest correction, or not finite
    slowed: int = 0  # corrections that changed faster than they may, and were followed more slowly
    overruns: int = 0  # cycles of `corrected` that began more than a period late
    refused: Counter[str] = field(default_factory=Counter)
    round_trips_s: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))

    def quantile(self, fraction: float) -> float:
        """Round trip in seconds below which ``fraction`` of the answers came; NaN without any."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(len(ordered) - 1, int(fraction * len(ordered)))] if ordered else math.nan

    def document(self) -> dict[str, Any]:
        """Everything as JSON-able numbers, round trips in microseconds."""
        trips = {f"p{p}": round(self.quantile(p / 100) * 1e6, 1) for p in (50, 95, 99)} if self.round_trips_s else {}
        counts = {k: v for k, v in vars(self).items() if isinstance(v, int)}
        return {**counts, "refused": dict(self.refused), "round_trip_us": trips}
