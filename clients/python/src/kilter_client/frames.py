"""Bytes of the stream as docs/reference/stream.md tables them: the client's own codec, standard library only."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

MAGIC = b"KLT1"
HEADER = struct.Struct("<4sBBHQQQ")  # magic, kind, joints, flags, seq, t_send_ns, t_apply_ns
VERDICT = struct.Struct("<QIHHIi")  # version, epoch, status, limit mask, processing ns, left nm
BLOCK = struct.Struct("<II")  # points, step_ns
POINT, CHUNK = 0, 1
QD, QDD, VERSION, RESET, SETTLED = 0x0001, 0x0002, 0x0004, 0x0008, 0x0010
DYNAMIC, RAMPING, LIMITED, DAMPED, RESIDUAL, SATURATED, SLOWED = (1 << k for k in range(8, 15))
STATUSES = (
    "OK", "STALE", "SEQ_GAP", "SEQ_BACK", "BAD_FRAME", "NOT_FINITE", "JOINT_LIMIT", "CORRECTION_TOO_LARGE",
    "RATE_LIMIT", "NO_VERSION", "VERSION_MISMATCH", "OVERLOAD", "NO_SESSION", "UNSIGNED", "SESSION_EXPIRED",
)  # fmt: skip


class Answer(NamedTuple):
    """A decoded answer; ``q`` holds the points one after another and is empty unless the status is OK."""

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
        seq, flags, version, epoch, STATUSES[status], mask, processing_ns, joints, q, sent, apply, kind, points, step_ns,
        left_nm,
    )  # fmt: skip
