"""Bytes of the stream as docs/reference/stream.md tables them: the client's own codec, standard library only.

What a stream gives back: a setpoint that says where it comes from, and the statistics of all of them.
"""

from __future__ import annotations

import math
import struct
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

MAGIC = b"KLT1"
HEADER = struct.Struct("<4sBBHQQQ")  # magic, kind, joints, flags, seq, t_send_ns, t_apply_ns
VERDICT = struct.Struct("<QIHHIi")  # version, epoch, status, limit mask, processing ns, left nm
BLOCK = struct.Struct("<II")  # points, step_ns
POINT, CHUNK = 0, 1
QD, QDD, VERSION, RESET, SETTLED = 0x0001, 0x0002, 0x0004, 0x0008, 0x0010
DYNAMIC, RAMPING, REVERSING, DAMPED, RESIDUAL, SATURATED, SLOWED, UNSURE = (1 << k for k in range(8, 16))
STATUSES = (
    "OK",
    "STALE",
    "SEQ_GAP",
    "SEQ_BACK",
    "BAD_FRAME",
    "NOT_FINITE",
    "JOINT_LIMIT",
    "CORRECTION_TOO_LARGE",
    "RATE_LIMIT",
    "NO_VERSION",
    "VERSION_MISMATCH",
    "OVERLOAD",
    "NO_SESSION",
    "UNSIGNED",
    "SESSION_EXPIRED",
)


class Made:
    """How a correction was made, by the flags of its answer. ``flags`` 0: not corrected, or by no answer of this cycle."""

    __slots__ = ()
    flags: int

    @property
    def dynamic(self) -> bool:
        """The loads include the motion."""
        return bool(self.flags & DYNAMIC)

    @property
    def ramping(self) -> bool:
        """The start of the stream or a change of version is still being ramped in."""
        return bool(self.flags & RAMPING)

    @property
    def reversing(self) -> bool:
        """Clearance or backlash changes sides: its sign is softened near zero load, or held to its rate."""
        return bool(self.flags & REVERSING)

    @property
    def damped(self) -> bool:
        """Near a singularity: a direction that the joints can hardly move in is given up, orientation before position."""
        return bool(self.flags & DAMPED)

    @property
    def residual(self) -> bool:
        """The wanted pose cannot be reached; the nearest was taken."""
        return bool(self.flags & RESIDUAL)

    @property
    def saturated(self) -> bool:
        """The correction is held at the limits of the version."""
        return bool(self.flags & SATURATED)

    @property
    def slowed(self) -> bool:
        """The correction comes later than it should: held back by a bound on its rate or acceleration."""
        return bool(self.flags & SLOWED)

    @property
    def unsure(self) -> bool:
        """The version is less sure here than its parameters say: near a pose it does not explain, or as a whole."""
        return bool(self.flags & UNSURE)


class _Answer(NamedTuple):
    seq: int
    flags: int
    version: int
    epoch: int
    status: str
    limit_mask: int
    processing_ns: int
    joints: int
    q: tuple[float, ...]
    t_send_ns: int = 0
    t_apply_ns: int = 0
    kind: int = POINT
    points: int = 1
    step_ns: int = 0
    left_nm: int = 0
    lag: float = 0.0


class Answer(Made, _Answer):
    """A decoded answer; ``q`` holds the points one after another and is empty unless the status is OK.

    ``lag`` is how far a joint of ``q`` is at most from what the corrector answered, rad or m: the stream follows an answer
    more slowly that changes faster than it may.
    """

    __slots__ = ()

    @property
    def slowed(self) -> bool:
        """The correction comes later than it should: held back by a bound on its rate, in the corrector or here."""
        return self.lag > 0.0 or bool(self.flags & SLOWED)

    @property
    def left_mm(self) -> float | None:
        """How far the tool stays from where it should be, by the version; None when ``q`` is not what was answered."""
        return self.left_nm * 1e-6 if self.status == "OK" and not self.lag else None


def encode(
    values: Sequence[float],
    *,
    joints: int,
    seq: int,
    t_send_ns: int,
    t_apply_ns: int = 0,
    flags: int = 0,
    version: int | None = None,
    points: int | None = None,
    step_ns: int = 0,
) -> bytes:
    """Bytes of a setpoint, or of a chunk when ``points`` is given; ``values``: q, then qd and qdd, of each point."""
    kind = POINT if points is None else CHUNK
    out = HEADER.pack(MAGIC, kind, joints, flags | (VERSION if version is not None else 0), seq, t_send_ns, t_apply_ns)
    if version is not None:
        out += version.to_bytes(8, "little")
    if points is not None:
        out += BLOCK.pack(points, step_ns)
    return out + struct.pack(f"<{len(values)}d", *values)


def decode(data: bytes) -> Answer | None:
    """Read an answer; None when the bytes are not one."""
    start = HEADER.size + VERDICT.size
    if len(data) < start:
        return None
    magic, kind, joints, flags, seq, sent, apply = HEADER.unpack_from(data)
    version, epoch, status, mask, processing_ns, left_nm = VERDICT.unpack_from(data, HEADER.size)
    if magic != MAGIC or status >= len(STATUSES) or (status == 0) != (joints > 0) or left_nm < 0:
        return None
    points, step_ns = 1, 0
    if status == 0 and kind == CHUNK:
        if len(data) < start + BLOCK.size:
            return None
        points, step_ns = BLOCK.unpack_from(data, start)
        start += BLOCK.size
    if len(data) != start + 8 * points * joints:
        return None
    q = struct.unpack_from(f"<{points * joints}d", data, start)
    return Answer(
        seq,
        flags,
        version,
        epoch,
        STATUSES[status],
        mask,
        processing_ns,
        joints,
        q,
        sent,
        apply,
        kind,
        points,
        step_ns,
        left_nm,
    )


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
