"""CDR bytes of ``sensor_msgs/JointState`` and ``trajectory_msgs/JointTrajectory``, whole trajectories at once.

Points that carry the same numbers of positions, velocities, accelerations and efforts repeat one layout of bytes, apart
from the first, which may be shifted by four bytes; so all of them are read and written as one array of records. Alignment
counts from the end of the four bytes that say how the rest is encoded.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_core.types import Floats

Order = Literal["<", ">"]

LITTLE = b"\x00\x01\x00\x00"
START = len(LITTLE)
TEXTS = START + 8  # behind the time stamp
MOST_NAMES = 256
MOST_POINTS = 1_000_000
NANO = 1e-9
PARTS = ("positions", "velocities", "accelerations", "effort")


_last_texts: dict[Order, tuple[bytes, str, tuple[str, ...]]] = {}


class CdrError(ValueError):
    """Bytes that are not the message expected."""


class Head(NamedTuple):
    """What both messages begin with: time stamp (s, ns), frame and joint names."""

    stamp: tuple[int, int]
    frame_id: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class JointState:
    """One state; ``velocity`` and ``effort`` may be empty."""

    head: Head
    position: Floats
    velocity: Floats
    effort: Floats


@dataclass(frozen=True)
class JointTrajectory:
    """N points, ``time (N, 2)`` seconds and nanoseconds from the start; each part (N, J), or (N, 0) when not given."""

    head: Head
    time: NDArray[np.int32]
    positions: Floats
    velocities: Floats
    accelerations: Floats
    effort: Floats

    @property
    def t(self) -> Floats:
        """Times from the start, s."""
        return np.asarray(self.time[:, 0] + self.time[:, 1].view(np.uint32) * NANO)


def encode_joint_state(state: JointState) -> bytes:
    """Bytes as rmw and rosbags write them, little-endian."""
    out = _written_head(state.head)
    for part in (state.position, state.velocity, state.effort):
        _write_floats(out, part)
    return bytes(out)


def decode_joint_state(data: bytes) -> JointState:
    """Read a state.

    Raises:
        CdrError: anything else, or cut off.

    """
    order = _order(data)
    head, offset = _read_head(data, order)
    parts = []
    for _ in range(3):
        part, offset = _read_floats(data, offset, order)
        parts.append(part)
    _expect_end(data, offset)
    return JointState(head, *parts)


def encode_joint_trajectory(trajectory: JointTrajectory) -> bytes:
    """Bytes as rmw and rosbags write them, little-endian."""
    out = _written_head(trajectory.head)
    points = len(trajectory.time)
    out += struct.pack("<I", points)
    if not points:
        return bytes(out)
    counts = tuple(getattr(trajectory, name).shape[1] for name in PARTS)
    first, rest = _layouts(counts, (len(out) - START) % 8)
    body = np.zeros(len(out) + first.itemsize + (points - 1) * rest.itemsize, np.uint8)
    body[: len(out)] = out
    head_row, rows = _records(body.data, len(out), first, rest, points)
    _fill(head_row, rows, "time", np.ascontiguousarray(trajectory.time, "<i4"))
    for name, count in zip(PARTS, counts, strict=True):
        if count:
            head_row[f"n_{name}"] = rows[f"n_{name}"] = count
            _fill(head_row, rows, name, np.ascontiguousarray(getattr(trajectory, name), "<f8"))
    return body.tobytes()


def decode_joint_trajectory(data: bytes) -> JointTrajectory:
    """Read a trajectory whose points all carry the same numbers.

    Raises:
        CdrError: anything else, or cut off, or points that differ in what they carry.

    """
    order = _order(data)
    head, offset = _read_head(data, order)
    points, offset = _read_count(data, offset, order, MOST_POINTS)
    if not points:
        _expect_end(data, offset)
        none = np.zeros((0, 0))
        return JointTrajectory(head, np.zeros((0, 2), np.int32), none, none, none, none)
    counts = _counts(data, offset, order)
    first, rest = _layouts(counts, (offset - START) % 8)
    _expect_end(data, offset + first.itemsize + (points - 1) * rest.itemsize)
    head_row, rows = _records(data, offset, first, rest, points)
    for name, count in zip(PARTS, counts, strict=True):
        if rows[f"n_{name}"].tobytes() != _repeated_count_bytes(count, points - 1, order):
            raise CdrError("the points of the trajectory differ in what they carry")
    found = {
        name: _field_rows(head_row, rows, name, order, np.float64) if count else np.zeros((points, 0))
        for name, count in zip(PARTS, counts, strict=True)
    }
    return JointTrajectory(head, _field_rows(head_row, rows, "time", order, np.int32), **found)


def _records(
    data: bytes | memoryview, offset: int, first: np.dtype[np.void], rest: np.dtype[np.void], points: int
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """The first point and the others as records of the bytes."""
    return (
        np.frombuffer(data, dtype=first, offset=offset, count=1),
        np.frombuffer(data, dtype=rest, offset=offset + first.itemsize, count=points - 1),
    )


def _fill(first: NDArray[np.void], rest: NDArray[np.void], name: str, values: NDArray[Any]) -> None:
    """Put the rows of ``values`` (N, k) into a field."""
    raw = values.view(first.dtype[name])[:, 0]
    first[name], rest[name] = raw[:1], raw[1:]


def _field_rows(
    first: NDArray[np.void], rest: NDArray[np.void], name: str, order: Order, kind: type[Any]
) -> NDArray[Any]:
    """A field as rows (N, k) of the machine's numbers."""
    raw = np.empty(len(rest) + 1, first.dtype[name])
    raw[:1], raw[1:] = first[name], rest[name]
    values = raw.view(np.dtype(kind).newbyteorder(order)).reshape(len(raw), -1)
    return values.astype(kind, copy=False)


@lru_cache(maxsize=64)
def _layouts(counts: tuple[int, ...], phase: int) -> tuple[np.dtype[np.void], np.dtype[np.void]]:
    """Records of the first point, that begins at ``phase`` of eight bytes, and of every other."""
    first, end = _layout(counts, phase)
    # Behind the last doubles the phase is always the same, so it repeats from the second point on.
    rest, _ = _layout(counts, end)
    return first, rest


def _layout(counts: tuple[int, ...], phase: int) -> tuple[np.dtype[np.void], int]:
    """One point as a record, its numbers as bytes (copied twice as fast), and the phase behind it."""
    fields: list[tuple[str, str, int]] = []
    at = phase
    for name, count in zip(PARTS, counts, strict=True):
        fields.append((f"n_{name}", "<u4", at - phase))
        at += 4
        if count:
            at += -at % 8
            fields.append((name, f"V{8 * count}", at - phase))
            at += 8 * count
    fields.append(("time", "V8", at - phase))
    at += 8
    names, formats, offsets = zip(*fields, strict=True)
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at - phase})
    return record, at % 8


@lru_cache(maxsize=64)
def _repeated_count_bytes(count: int, times: int, order: Order) -> bytes:
    """What a column of equal counts looks like; comparing bytes is four times as fast as comparing numbers."""
    return np.full(times, count, f"{order}u4").tobytes()


def _counts(data: bytes, offset: int, order: Order) -> tuple[int, ...]:
    """How many numbers of each part the first point carries."""
    counts = []
    for _ in PARTS:
        count, offset = _read_count(data, offset, order, MOST_NAMES)
        if count:
            offset += -(offset - START) % 8 + 8 * count
        counts.append(count)
    return tuple(counts)


def _order(data: bytes) -> Order:
    if len(data) < START or data[0] != 0 or data[1] > 1:
        raise CdrError("the bytes do not begin as plain CDR")
    return "<" if data[1] else ">"


def _read_count(data: bytes, offset: int, order: Order, most: int) -> tuple[int, int]:
    offset += -offset % 4
    try:
        (count,) = struct.unpack_from(f"{order}I", data, offset)
    except struct.error:
        raise CdrError("cut off") from None
    if count > most:
        raise CdrError(f"a sequence of {count} elements: at most {most} are allowed")
    return int(count), offset + 4


def _read_text(data: bytes, offset: int, order: Order) -> tuple[str, int]:
    size, offset = _read_count(data, offset, order, len(data))
    raw = data[offset : offset + size]
    if len(raw) != size or not raw.endswith(b"\x00"):
        raise CdrError("a text is cut off")
    try:
        return raw[:-1].decode(), offset + size
    except UnicodeDecodeError:
        raise CdrError("a text is not UTF-8") from None


def _read_head(data: bytes, order: Order) -> tuple[Head, int]:
    try:
        stamp = struct.unpack_from(f"{order}iI", data, START)
    except struct.error:
        raise CdrError("cut off") from None
    raw, frame_id, names = _last_texts.get(order, (b"", "", ()))
    if not raw or not data.startswith(raw, TEXTS):
        frame_id, names, end = _read_texts(data, order)
        # A publisher repeats its names in every message; reading them is most of the work for a single state.
        raw = data[TEXTS:end]
        _last_texts[order] = raw, frame_id, names
    return Head(stamp, frame_id, names), TEXTS + len(raw)


def _read_texts(data: bytes, order: Order) -> tuple[str, tuple[str, ...], int]:
    frame_id, offset = _read_text(data, TEXTS, order)
    count, offset = _read_count(data, offset, order, MOST_NAMES)
    names = []
    for _ in range(count):
        name, offset = _read_text(data, offset, order)
        names.append(name)
    return frame_id, tuple(names), offset


def _read_floats(data: bytes, offset: int, order: Order) -> tuple[Floats, int]:
    count, offset = _read_count(data, offset, order, MOST_NAMES)
    if not count:
        return np.zeros(0), offset
    offset += -(offset - START) % 8
    if offset + 8 * count > len(data):
        raise CdrError("cut off")
    values = np.frombuffer(data, dtype=f"{order}f8", offset=offset, count=count).astype(np.float64)
    return values, offset + 8 * count


def _expect_end(data: bytes, offset: int) -> None:
    """Raise CdrError unless the message ends here, but for padding to four bytes."""
    if not 0 <= len(data) - offset < 4:
        raise CdrError(f"{len(data)} bytes instead of {offset}")


def _written_head(head: Head) -> bytearray:
    return bytearray(LITTLE + struct.pack("<iI", *head.stamp) + _texts(head.frame_id, head.names))


@lru_cache(maxsize=256)
def _texts(frame_id: str, names: tuple[str, ...]) -> bytes:
    """Frame and names behind a stamp; they start at a multiple of four and end at one."""
    out = bytearray(_text(frame_id))
    out += bytes(-len(out) % 4) + struct.pack("<I", len(names))
    for name in names:
        out += bytes(-len(out) % 4) + _text(name)
    return bytes(out + bytes(-len(out) % 4))


def _text(text: str) -> bytes:
    raw = text.encode() + b"\x00"
    return struct.pack("<I", len(raw)) + raw


def _write_floats(out: bytearray, values: Floats) -> None:
    out += struct.pack("<I", len(values))
    if len(values):
        out += bytes(-(len(out) - START) % 8)
        out += np.asarray(values, dtype="<f8").tobytes()
