"""What a stream gives back: a setpoint that says where it comes from, and the statistics of all of them."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

from kilter_client.streaming.frames import DAMPED, REVERSING, SATURATED, SLOWED, Made

NAMES = {REVERSING: "reversing", DAMPED: "damped", SATURATED: "saturated", SLOWED: "slowed"}
HELD_BACK = REVERSING | DAMPED | SATURATED | SLOWED

From = Literal["corrected", "slowed", "held", "bypass"]


class Setpoint(Made, tuple[float, ...]):
    """Joints to send to the arm, and where they come from.

    Only ``source`` "corrected" means that they are what the corrector answered. ``lag`` is how far each joint is from that,
    rad or m: zeros there, empty where there was no answer ("held", "bypass"). ``lag_mm`` is at most the distance at the tool
    that this causes; None where the corrector does not say how far the tool is from the axes of the joints.
    """

    source: From
    status: str | None  # the corrector's verdict; None when no answer came in time
    wanted: tuple[float, ...]
    flags: int
    round_trip_s: float | None
    left_nm: int | None
    lag: tuple[float, ...]
    lag_mm: float | None

    def __new__(
        cls,
        q: Iterable[float],
        *,
        source: From,
        wanted: tuple[float, ...],
        status: str | None = None,
        flags: int = 0,
        round_trip_s: float | None = None,
        left_nm: int | None = None,
        lag: tuple[float, ...] = (),
        lag_mm: float | None = None,
    ) -> Setpoint:
        """Make a setpoint of ``q``."""
        made = super().__new__(cls, q)
        made.source, made.status, made.wanted, made.flags = source, status, wanted, flags
        made.round_trip_s, made.left_nm, made.lag, made.lag_mm = round_trip_s, left_nm, lag, lag_mm
        return made

    @property
    def delta(self) -> tuple[float, ...]:
        """The correction of each joint."""
        return tuple(a - b for a, b in zip(self, self.wanted, strict=True))

    @property
    def slowed(self) -> bool:
        """The correction comes later than it should: held back by a bound on its rate, in the corrector or here."""
        return self.source == "slowed" or bool(self.flags & SLOWED)

    @property
    def left_mm(self) -> float | None:
        """How far the tool stays from where it should be, by the version; None unless ``source`` is "corrected"."""
        return None if self.left_nm is None else self.left_nm * 1e-6


@dataclass
class Statistics:
    """What happened to the setpoints of a stream."""

    sent: int = 0
    corrected: int = 0  # with exactly what the corrector answered
    slowed: int = 0  # with less: its correction changed faster than it may here, or fades in after a bypass
    held: int = 0
    bypassed: int = 0
    missed: int = 0  # no answer within the deadline
    late: int = 0  # answers dropped because their cycle was over
    unknown_epoch: int = 0
    malformed: int = 0
    forged: int = 0  # dropped: not signed with the key in use
    foreign: int = 0  # dropped: they do not echo a setpoint of this stream
    too_large: int = 0  # dropped: beyond the largest correction, or not finite
    overruns: int = 0  # cycles of `corrected` that began more than a period late
    refused: Counter[str] = field(default_factory=Counter)
    held_back: Counter[str] = field(default_factory=Counter)  # answers by flag: reversing, damped, saturated, slowed
    most_left_nm: int = 0  # of the error of the tool, of all answers
    round_trips_s: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))

    def quantile(self, fraction: float) -> float:
        """Round trip in seconds below which ``fraction`` of the answers came; NaN without any."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(len(ordered) - 1, int(fraction * len(ordered)))] if ordered else math.nan

    def document(self) -> dict[str, Any]:
        """Everything as JSON-able numbers, round trips in microseconds."""
        trips = {f"p{p}": round(self.quantile(p / 100) * 1e6, 1) for p in (50, 95, 99)} if self.round_trips_s else {}
        counts = {k: v for k, v in vars(self).items() if isinstance(v, int) and k != "most_left_nm"}
        left = {"held_back": dict(self.held_back), "most_left_mm": self.most_left_nm * 1e-6}
        return {**counts, "refused": dict(self.refused), **left, "round_trip_us": trips}

    def note(self, flags: int, left_nm: int) -> None:
        """Count what held an answer back."""
        if left_nm > self.most_left_nm:
            self.most_left_nm = left_nm
        if flags & HELD_BACK:
            for flag, name in NAMES.items():
                if flags & flag:
                    self.held_back[name] += 1
