"""As much of the protobuf wire format as EGM needs: fields of a message, and its numbers."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

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
