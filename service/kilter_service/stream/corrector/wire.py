"""Bytes of the stream, little-endian, as docs/reference/stream.md tables them.

Every frame starts with the same 32-byte header. What comes back adds 24 bytes of verdict, and carries numbers only
when the status is OK: a refused setpoint leaves nothing that could be sent to a motor by mistake.

Which frame of a stream comes next, and how old it is; docs/reference/stream.md states these rules.

Clocks of two machines are never compared. The smallest difference between arrival and sending seen so far counts
as the transit time, and the age of a frame is what exceeds that. One frame never decides: one that does not fit is refused and
leaves the stream as it is, until a second frame continues from it.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kilter_core.types import Floats
from kilter_service.contract.streams import Flag as Flag
from kilter_service.contract.streams import Kind as Kind
from kilter_service.contract.streams import Status as Status
from kilter_service.stream.corrector.session import Rules

MAGIC = b"KLT1"
HEADER = struct.Struct("<4sBBHQQQ")  # magic, kind, joints, flags, seq, t_send_ns, t_apply_ns
VERDICT = struct.Struct("<QIHHIi")  # version, epoch, status, limit mask, processing ns, left nm
BLOCK = struct.Struct("<II")  # points, step_ns of a chunk; points, joints of a trajectory
VERSION = struct.Struct("<Q")

MAX_JOINTS = 16  # the limit mask has 16 bits
MAX_CHUNK = 4096
MAX_TRAJECTORY = 1_000_000
MOST_LEFT_NM = 2**31 - 1  # what is left beyond two metres is said to be this


IN_FLAGS = 0x001F


class FrameError(ValueError):
    """Bytes that are not a message. ``header`` is what could still be read, for the answer."""

    def __init__(self, message: str, header: Header | None = None) -> None:
        super().__init__(message)
        self.header = header


class Header(NamedTuple):
    """First 32 bytes of a frame, without the magic."""

    kind: int
    joints: int
    flags: int
    seq: int
    t_send_ns: int
    t_apply_ns: int


class Setpoints(NamedTuple):
    """A decoded request: ``values (points, width * joints)`` holds q, then qd and qdd when the flags say so."""

    header: Header
    values: Floats
    step_ns: int
    version: int | None


class Answer(NamedTuple):
    """A decoded answer: ``values (points, joints)``, empty unless the status is OK."""

    header: Header
    version: int
    epoch: int
    status: Status
    limit_mask: int
    processing_ns: int
    left_nm: int
    step_ns: int
    values: Floats


def width(flags: int) -> int:
    """How many vectors of joints one point has: 1 with q, 2 with qd, 3 with qdd."""
    return 1 + bool(flags & Flag.QD) + bool(flags & Flag.QDD)


def nanometres(left: Floats) -> int:
    """Length of the longest of the errors ``left (..., 3)`` m as it stands in an answer; the fast path computes the same."""
    x, y, z = left[..., 0], left[..., 1], left[..., 2]
    return int(min(1e9 * math.sqrt(np.max(x * x + y * y + z * z)) + 0.5, MOST_LEFT_NM))


def decode_header(data: bytes) -> Header:
    """Read the header.

    Raises:
        FrameError: too short, or another magic.

    """
    if len(data) < HEADER.size:
        raise FrameError(f"{len(data)} bytes are fewer than the {HEADER.size} of a header")
    magic, *rest = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise FrameError(f"magic {magic!r} instead of {MAGIC!r}")
    return Header(*rest)


def decode_setpoints(data: bytes) -> Setpoints:
    """Read a point or a chunk. The numbers are writable, because numba compiles read-only arrays separately.

    Raises:
        FrameError: anything that is not exactly such a message.

    """
    header = decode_header(data)
    flags = header.flags
    if header.kind > Kind.CHUNK or not 0 < header.joints <= MAX_JOINTS or flags & ~IN_FLAGS:
        raise FrameError("unknown kind, flags or number of joints", header)
    if flags & Flag.QDD and not flags & Flag.QD:
        raise FrameError("accelerations without velocities", header)
    offset = HEADER.size
    version = None
    points, step_ns = 1, 0
    try:
        if flags & Flag.VERSION:
            (version,) = VERSION.unpack_from(data, offset)
            offset += VERSION.size
        if header.kind == Kind.CHUNK:
            points, step_ns = BLOCK.unpack_from(data, offset)
            offset += BLOCK.size
    except struct.error:
        raise FrameError("cut off", header) from None
    if not 0 < points <= MAX_CHUNK:
        raise FrameError(f"a chunk of {points} points", header)
    columns = header.joints * width(flags)
    if len(data) != offset + 8 * points * columns:
        raise FrameError(f"{len(data)} bytes instead of {offset + 8 * points * columns}", header)
    values = np.frombuffer(bytearray(data), dtype="<f8", offset=offset).reshape(points, columns)
    return Setpoints(header, values, step_ns, version)


def encode_setpoints(
    values: Floats,
    *,
    joints: int,
    seq: int,
    t_send_ns: int,
    t_apply_ns: int,
    flags: int = 0,
    step_ns: int | None = None,
    version: int | None = None,
) -> bytes:
    """Bytes of a point, or of a chunk when ``step_ns`` is given. ``values (points, width * joints)``."""
    kind = Kind.POINT if step_ns is None else Kind.CHUNK
    if version is not None:
        flags |= Flag.VERSION
    parts = [HEADER.pack(MAGIC, kind, joints, flags, seq, t_send_ns, t_apply_ns)]
    if version is not None:
        parts.append(VERSION.pack(version))
    if step_ns is not None:
        parts.append(BLOCK.pack(len(values), step_ns))
    parts.append(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return b"".join(parts)


def encode_answer(
    header: Header,
    numbers: bytes,
    *,
    version: int,
    epoch: int,
    flags: int = 0,
    limit_mask: int = 0,
    processing_ns: int = 0,
    left_nm: int = 0,
    points: int = 1,
    step_ns: int = 0,
) -> bytes:
    """Bytes of an OK answer: the header echoed, the verdict, then the corrected joints in ``numbers``."""
    head = HEADER.pack(MAGIC, header.kind, header.joints, flags, header.seq, header.t_send_ns, header.t_apply_ns)
    verdict = VERDICT.pack(version, epoch, 0, limit_mask, processing_ns, left_nm)
    if header.kind == Kind.CHUNK:
        return head + verdict + BLOCK.pack(points, step_ns) + numbers
    return head + verdict + numbers


def encode_refusal(
    header: Header, status: Status, *, version: int = 0, epoch: int = 0, limit_mask: int = 0, processing_ns: int = 0
) -> bytes:
    """Bytes of an answer that is not OK: no joints, no numbers."""
    head = HEADER.pack(MAGIC, header.kind, 0, 0, header.seq, header.t_send_ns, header.t_apply_ns)
    return head + VERDICT.pack(version, epoch, status, limit_mask, processing_ns, 0)


def decode_answer(data: bytes) -> Answer:
    """Read an answer.

    Raises:
        FrameError: anything that is not exactly such a message.

    """
    header = decode_header(data)
    offset = HEADER.size + VERDICT.size
    if len(data) < offset:
        raise FrameError("cut off", header)
    version, epoch, status, mask, processing_ns, left_nm = VERDICT.unpack_from(data, HEADER.size)
    if status not in Status._value2member_map_ or header.joints > MAX_JOINTS or left_nm < 0:
        raise FrameError(f"unknown status {status} or number of joints, or less than nothing is left", header)
    points, step_ns = 1, 0
    if status == Status.OK and header.kind == Kind.CHUNK:
        if len(data) < offset + BLOCK.size:
            raise FrameError("cut off", header)
        points, step_ns = BLOCK.unpack_from(data, offset)
        offset += BLOCK.size
    if (status == Status.OK) != (header.joints > 0) or len(data) != offset + 8 * points * header.joints:
        raise FrameError("numbers do not fit the status or the number of joints", header)
    values = np.frombuffer(data, dtype="<f8", offset=offset).reshape(-1, max(header.joints, 1))
    return Answer(header, version, epoch, Status(status), mask, processing_ns, left_nm, step_ns, values)


@dataclass(frozen=True)
class Late:
    """Frames in a row that are too old: when the run began, with which transit time, and its last sequence number."""

    since_ns: int
    transit_ns: int
    seq: int


@dataclass
class Clock:
    """State of a stream: its last sequence number, and times in ns; ``transit_ns`` is the shortest transit time seen."""

    seq: int = -1
    transit_ns: int | None = None
    seen_ns: int = 0  # arrival of the last frame in order
    sent_ns: int = 0  # when that was sent
    pace_ns: int = 0  # between it and the one before
    applied_ns: int = 0
    answered_ns: int = 0
    rival: tuple[int, int] | None = None  # a sequence number too far ahead, and the one it came after
    late: Late | None = None

    def follows(self, seq: int) -> bool:
        """Whether ``seq`` is the next in order, or goes on from one that was refused for being too far ahead."""
        return self.seq < 0 or seq == self.seq + 1 or self.rival == (seq - 1, self.seq)

    def refuse(self, seq: int, arrival_ns: int, sent_ns: int, overloaded: bool, rules: Rules) -> Status:
        """Verdict on a frame out of order. The stream stays where it is; the next frame may prove this one right."""
        if seq <= self.seq:
            return Status.SEQ_BACK
        self.rival = (seq, self.seq)
        if self.age(arrival_ns, sent_ns, rules)[0] > rules.max_age_ns:
            return Status.STALE
        return Status.OVERLOAD if overloaded else Status.SEQ_GAP

    def age(self, arrival_ns: int, sent_ns: int, rules: Rules) -> tuple[int, int]:
        """How old a frame is, and the transit time that follows from it."""
        transit = arrival_ns - sent_ns
        if self.transit_ns is None:
            return 0, transit
        if self.sent_ns - sent_ns > rules.set_back_ns:
            # Frames in order are sent in order, so the clock was set back. Only the time that really passed tells how much
            # older this frame can be than the one before: a burst after a hang stays old.
            before = self.seen_ns - self.sent_ns - self.transit_ns
            age = max(0, before + arrival_ns - self.seen_ns - self.pace_ns)
            return age, transit - age
        least = min(transit, self.transit_ns + int((arrival_ns - self.seen_ns) * rules.clock_drift))
        return transit - least, least

    def advance_to_frame(self, seq: int, arrival_ns: int, sent_ns: int, rules: Rules) -> bool:
        """Go on to a frame in order; False when it is too old."""
        age, least = self.age(arrival_ns, sent_ns, rules)
        if age > rules.max_age_ns and self._agrees(seq, arrival_ns, arrival_ns - sent_ns, rules):
            age, least = 0, arrival_ns - sent_ns
        if self.transit_ns is not None:
            self.pace_ns = min(max(0, sent_ns - self.sent_ns), max(0, arrival_ns - self.seen_ns))
        self.seq, self.transit_ns, self.seen_ns, self.sent_ns = seq, least, arrival_ns, sent_ns
        return age <= rules.max_age_ns

    def _agrees(self, seq: int, arrival_ns: int, transit_ns: int, rules: Rules) -> bool:
        """Whether late frames have kept one pace for so long that the transit time is longer now; in a burst they catch up."""
        late = self.late
        if late is None or late.seq + 1 != seq or abs(transit_ns - late.transit_ns) > rules.agree_ns:
            late = Late(arrival_ns, transit_ns, seq)
        self.late = Late(late.since_ns, late.transit_ns, seq)
        return arrival_ns - late.since_ns >= rules.agree_for_ns

    def elapsed_s(self, at_ns: int, arrival_ns: int, slack_s: float) -> float:
        """Time since the last answered setpoint on the controller's clock, bounded by the time that really passed.

        A clock that was set back says nothing: then the time that passed counts.
        """
        passed = max(0.0, (arrival_ns - self.answered_ns) * 1e-9)
        step = (at_ns - self.applied_ns) * 1e-9
        return passed if step < 0.0 else min(step, passed + slack_s)
