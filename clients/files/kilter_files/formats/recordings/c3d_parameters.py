"""The header and the parameter section of a C3D file, read strictly: nothing outside the section, always forward."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.faults import fault
from kilter_files.ground.later import np

SECTOR = 512
MAGIC = 0x50
PROCESSORS = {84: "<", 86: ">"}
DEC = 85
WIDTHS = {-1: 1, 1: 1, 2: 2, 4: 4}

Value = tuple[float, ...] | tuple[str, ...]
BROKEN = "Export it again, or open and save it with a C3D tool."


@dataclass(frozen=True)
class Header:
    """The first sector: ``order`` is the byte order of numbers, ``at`` the sector of the parameters."""

    order: str
    points: int
    analog_per_frame: int
    first: int
    last: int
    scale: float
    data_sector: int
    rate_hz: float


def is_c3d(head: bytes) -> bool:
    """Tell whether a file's first bytes are those of a C3D file."""
    return len(head) >= SECTOR and head[1] == MAGIC and head[0] >= 2


def read_header(path: Path, content: bytes) -> Header:
    """Read the header from a file's first sectors.

    Raises:
        FileError: not a C3D file, cut off, or of a processor whose numbers nobody writes any more.

    """
    if not is_c3d(content):
        raise fault(
            path, "is not a C3D file (its second byte is not 0x50)", "Is it of another device? " + BROKEN, byte=1
        )
    start = (content[0] - 1) * SECTOR
    if len(content) < start + 4:
        raise fault(path, "is cut off before its parameters", BROKEN, byte=len(content))
    processor = content[start + 3]
    if processor == DEC:
        raise fault(path, "has DEC (VAX) numbers", "Save it in Intel format with a C3D tool.", byte=start + 3)
    order = PROCESSORS.get(processor)
    if order is None:
        raise fault(path, f"states the unknown processor type {processor}", BROKEN, byte=start + 3)
    words = struct.unpack_from(f"{order}6H", content)
    scale, sector, _, rate = struct.unpack_from(f"{order}fHHf", content, 12)
    return Header(order, words[1], words[2], words[3], words[4], scale, sector, rate)


def read_parameters(path: Path, content: bytes, order: str) -> dict[str, Value]:
    """Read the parameters as ``GROUP:NAME``.

    Raises:
        FileError: an entry that leads outside the section or backwards.

    """
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Value] = {}
    start = (content[0] - 1) * SECTOR
    end = min(len(content), start + max(1, content[start + 2]) * SECTOR)
    at = start + 4
    while at + 2 <= end:
        length, group = struct.unpack_from("bb", content, at)
        if length == 0 or group == 0:
            break
        name_end = at + 2 + abs(length)
        if name_end + 2 > end:
            raise fault(path, "its parameters run over their end", BROKEN, byte=at)
        name = content[at + 2 : name_end].decode("latin-1").strip().upper()
        (jump,) = struct.unpack_from(f"{order}H", content, name_end)
        if group < 0:
            groups[-group] = name
        else:
            found[group, name] = _value(path, content, name_end + 2, end, order)
        if jump == 0:
            break
        at = name_end + jump
    return {f"{groups.get(group, '?')}:{name}": value for (group, name), value in found.items()}


def _value(path: Path, content: bytes, at: int, end: int, order: str) -> Value:
    if at + 2 > end:
        raise fault(path, "its parameters run over their end", BROKEN, byte=at)
    kind, rank = struct.unpack_from("bB", content, at)
    shape = tuple(content[at + 2 : at + 2 + rank])
    count, start = math.prod(shape), at + 2 + rank
    width = WIDTHS.get(kind)
    if width is None or rank > 7 or len(shape) < rank or start + count * width > end:
        raise fault(path, "a parameter claims more than its section holds", BROKEN, byte=at)
    raw = content[start : start + count * width]
    if kind == -1:
        size = shape[0] if shape else 1
        return tuple(raw[i : i + size].decode("latin-1").strip() for i in range(0, count, size)) if size else ()
    dtype = {1: "i1", 2: f"{order}i2", 4: f"{order}f4"}[kind]
    return tuple(float(value) for value in np.frombuffer(raw, dtype))


def number(parameters: Mapping[str, Value], name: str) -> float | None:
    """Return the first number of a parameter."""
    value = parameters.get(name, ())
    return value[0] if value and isinstance(value[0], float) and math.isfinite(value[0]) else None


def unsigned_parameter(parameters: Mapping[str, Value], name: str) -> int | None:
    """Return a parameter that counts: its 16 bits have no sign, and two of them are one number."""
    value = [int(v) for v in parameters.get(name, ()) if isinstance(v, float) and math.isfinite(v)]
    if not value:
        return None
    words = [v & 0xFFFF if v < 0 else v for v in value[:2]]
    return words[0] if len(words) == 1 else words[0] + (words[1] << 16)
