"""Protocols of controllers over UDP: ABB Externally Guided Motion, and KUKA RobotSensorInterface.

ABB Externally Guided Motion: protobuf over UDP. The controller asks; the answer echoes its number and has whole joints, deg.

KUKA RobotSensorInterface: XML over UDP. The controller asks every cycle; the answer has its IPOC and the offsets AK, deg.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from enum import StrEnum

from kilter_client.bridges.loop import Request, radians
from kilter_client.bridges.plan import Setpoints

# Whoever sends the message chooses its bytes: no search may go on beyond the element in which it began.
_IPOC = re.compile(rb"<IPOC>\s{0,9}+(\d{1,18}+)\s{0,9}+</IPOC>")
_DELAY = re.compile(rb"<Delay\s([^<>]{1,99}+)>")
_MISSED = re.compile(rb"\bD=[\"'](\d{1,9})[\"']")
_AXIS = re.compile(rb"\bA([1-6])=[\"']([^\"'<>]{1,32})[\"']")


class From(StrEnum):
    """Which joints of the message are the wanted ones."""

    SETPOINT = "ASPos"
    ACTUAL = "AIPos"


class RsiWire:
    """Messages for an arm of ``signs`` (n,): +1 where an axis has the direction of the robot's joint, -1 where the opposite.

    ``source`` ``ASPos`` takes the setpoints of the interpolator. ``AIPos`` takes the actual joints less the offsets that
    were answered before: for controllers that send nothing else.
    """

    def __init__(self, signs: Sequence[float], source: From = From.SETPOINT, cycle_ms: float = 4.0) -> None:
        self._signs, self._source, self._cycle_ms = tuple(signs), source, cycle_ms
        self._element = re.compile(rb"<" + source.value.encode() + rb"\s([^<>]{1,400}+)>")
        self._answered = (0.0,) * len(self._signs)
        self.counts: Counter[str] = Counter()

    def read(self, data: bytes) -> Request | None:
        """Return a request; None where the message is not whole, or without an IPOC, which an answer must have."""
        whole, ipoc = data.strip(b" \t\r\n\0"), _IPOC.search(data)
        if ipoc is None or not (whole.startswith(b"<Rob") and whole.endswith(b"</Rob>")):
            return None
        delay = _DELAY.search(data)
        missed = None if delay is None else _MISSED.search(delay[1])
        return Request(int(ipoc[1]), self._joints(data), None if missed is None else int(missed[1]))

    def _joints(self, data: bytes) -> tuple[float, ...] | None:
        found = self._element.search(data)
        if found is None:
            return None
        axes = {int(axis): text for axis, text in _AXIS.findall(found[1])}
        try:
            degrees = [float(axes[k]) for k in range(1, len(self._signs) + 1)]
        except (KeyError, ValueError):
            return None
        q = radians(degrees, self._signs)
        if self._source is From.ACTUAL:
            q = tuple(a - b for a, b in zip(q, self._answered, strict=True))
        return q

    def cycles(self, stamps: int) -> int | None:
        """Return the cycles between IPOCs so far apart, which count milliseconds; None where they count something else."""
        cycles, rest = divmod(stamps, self._cycle_ms)
        return round(cycles) if cycles >= 1.0 and rest == 0.0 else None

    def wanted_joints(self, request: Request, cycles: int, fresh: bool) -> Sequence[float] | None:
        """Return the joints of the message: the controller has its own plan."""
        return request.joints

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        """Return the answer: AK in deg, of axes beyond the robot's joints zero."""
        self._answered = tuple(offset)
        degrees = [math.degrees(sign * one) for sign, one in zip(self._signs, offset, strict=True)]
        degrees += [0.0] * (AXES - len(degrees))
        axes = " ".join(f'A{k}="{value:.6f}"' for k, value in enumerate(degrees, 1))
        return f'<Sen Type="Kilter"><AK {axes}/><IPOC>{request.stamp}</IPOC></Sen>'.encode()


VARINT, DOUBLE, TEXT, FLOAT = 0, 1, 2, 5
_DOUBLE = struct.Struct("<d")
_FIXED = {DOUBLE: 8, FLOAT: 4}
MOST_FIELDS = 64  # of a message; a robot's has some twenty


def fields(data: bytes) -> Iterator[tuple[int, int, int | bytes]]:
    """Yield number, wire type and value of each field.

    Raises:
        ValueError: the bytes are not a message, or one of more than ``MOST_FIELDS`` fields.

    """
    at = 0
    for _ in range(MOST_FIELDS):
        if at >= len(data):
            return
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(data, at)
            yield number, kind, value
            continue
        if kind == TEXT:
            size, at = _varint(data, at)
        elif kind in _FIXED:
            size = _FIXED[kind]
        else:
            raise ValueError(f"wire type {kind}")
        if at + size > len(data):
            raise ValueError("cut off")
        yield number, kind, data[at : at + size]
        at += size
    if at < len(data):
        raise ValueError("more fields than a robot's message has")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ValueError("cut off")
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number without an end")


def read_message(data: bytes, *path: int) -> bytes | None:
    """Return the message within a message that a path of field numbers leads to; None where it is not there."""
    for wanted in path:
        found = [value for number, kind, value in fields(data) if number == wanted and kind == TEXT]
        if not found:
            return None
        data = bytes(found[-1])
    return data


def read_number(data: bytes, wanted: int) -> int | None:
    """Return a whole number of a message; None where it is not there."""
    found = [value for number, kind, value in fields(data) if number == wanted and kind == VARINT]
    return int(found[-1]) if found else None


def read_doubles(data: bytes, wanted: int) -> list[float]:
    """Return repeated doubles, packed or not."""
    found: list[float] = []
    for number, kind, value in fields(data):
        if number != wanted or kind not in (DOUBLE, TEXT):
            continue
        content = bytes(value)
        if len(content) % _DOUBLE.size:
            raise ValueError("not whole doubles")
        found += [one for (one,) in _DOUBLE.iter_unpack(content)]
    return found


def varint(value: int) -> bytes:
    """A whole number, not negative."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def number(field: int, value: int) -> bytes:
    """A field with a whole number."""
    return varint(field << 3 | VARINT) + varint(value)


def message(field: int, content: bytes) -> bytes:
    """A field with a message."""
    return varint(field << 3 | TEXT) + varint(len(content)) + content


def doubles(field: int, values: Sequence[float]) -> bytes:
    """A repeated field of doubles, not packed: as proto2 has it."""
    key = varint(field << 3 | DOUBLE)
    return b"".join(key + _DOUBLE.pack(value) for value in values)


AXES = 6
HEADER, FEEDBACK, PLANNED, MCI = 1, 2, 2, 5  # fields of EgmRobot, and of EgmSensor: header and planned
JOINTS, SEQUENCE, TIME, KIND, STATE = 1, 1, 2, 3, 1
CORRECTION, RUNNING = 3, 3  # kind of a message; state of the motion


class EgmWire:
    """Messages for an arm of ``signs`` (n,): +1 where an axis has the direction of the robot's joint, -1 where the opposite."""

    def __init__(self, signs: Sequence[float], setpoints: Setpoints) -> None:
        self._signs, self._setpoints = tuple(signs), setpoints
        self._told: tuple[float, ...] | None = None  # the last joints that were answered

    @property
    def counts(self) -> Counter[str]:
        """What of the plan was not followed."""
        return self._setpoints.counts

    def read(self, data: bytes) -> Request | None:
        """Return a request; None when it is not the message of a robot."""
        try:
            header = read_message(data, HEADER)
            stamp = None if header is None else read_number(header, SEQUENCE)
            if header is None or stamp is None:
                return None
            state = read_message(data, MCI)
            moving = state is None or read_number(state, STATE) == RUNNING
            return Request(stamp, self._joints(data), None, moving, read_number(header, TIME) or 0)
        except ValueError:
            return None

    def _joints(self, data: bytes) -> tuple[float, ...] | None:
        joints = read_message(data, FEEDBACK, JOINTS)
        degrees = [] if joints is None else read_doubles(joints, JOINTS)
        good = len(degrees) == len(self._signs) and all(map(math.isfinite, degrees))
        if not good:  # the plan goes on: it needs the arm's joints at its beginning only
            self._setpoints.counts["joints_unusable"] += 1
            return None
        return radians(degrees, self._signs)

    def cycles(self, stamps: int) -> int | None:
        """Return the cycles between sequence numbers so far apart: as many."""
        return stamps

    def wanted_joints(self, request: Request, cycles: int, fresh: bool) -> Sequence[float] | None:
        """Return the setpoint: of the plan, and where the arm stands when the controller begins.

        The arm stands while cycles are lost, so that none of them has passed for the plan: it would have to jump. Where
        answers do not come to the controller, or it does not follow them, the plan waits for the arm.
        """
        if fresh:
            self._told = None
            return self._setpoints.start_from_joints(request.joints)
        if self._told is not None and request.joints is not None and self._setpoints.is_far(self._told, request.joints):
            self._setpoints.counts["arm_behind"] += 1
            return self._setpoints.at
        return self._setpoints.step(1)

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        """Return the answer; nothing before it is known where the arm stands."""
        if self._setpoints.at is None:
            return b""
        self._told = tuple(q + one for q, one in zip(self._setpoints.at, offset, strict=True))
        degrees = [math.degrees(sign * q) for sign, q in zip(self._signs, self._told, strict=True)]
        header = number(SEQUENCE, request.stamp) + number(TIME, request.clock) + number(KIND, CORRECTION)
        joints = message(JOINTS, doubles(JOINTS, degrees))
        return message(HEADER, header) + message(PLANNED, joints)
