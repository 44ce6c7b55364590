"""C3D recordings of markers."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import NO_HINTS, Head, Hints, RecordingReader
from kilter_files.ground.errors import CUT, fault, read_head
from kilter_files.ground.later import np
from kilter_files.ground.units import SIZES
from kilter_files.tables.recording import Block, Recording, frames_per_block, in_stated_unit, without_gaps

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording

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


# C3D files of 3D points, as Optotrak, Qualisys and Vicon write them.
#
# Read here and not with a library: one that was tried stops at frame 65 535, takes files that are cut off for whole,
# and holds every frame in memory.

FULL = 0xFFFF  # a 16-bit counter that ran out
HEAD_BYTES = 256 * SECTOR * 2  # header and the largest parameter section
FASTEST_HZ = 1e6
# Groups of labels that are not places: three angles, a force (the C3D user guide, POINT:TYPE_GROUPS).
NO_PLACES = re.compile(r"POINT:((?:ANGLE|FORCE|MOMENT|POWER|SCALAR|REACTION)S)\d*")


@dataclass(frozen=True)
class Layout:
    """Where the frames are and how a number becomes mm."""

    dtype: np.dtype[np.float32] | np.dtype[np.int16]
    points: int
    words: int
    start: int
    frames: int
    to_mm: float
    rate_hz: float
    unit: str


def read_c3d(path: Path, allow_cut: bool = False) -> Recording:
    """Read a C3D file; with ``allow_cut`` one that ends before the frames it states, as far as it goes.

    Raises:
        FileError: another file, cut off, two glued together, without points, or in an unknown unit.

    """
    content = read_head(path, HEAD_BYTES)
    header = read_header(path, content)
    parameters = read_parameters(path, content, header.order)
    notes: list[str] = []
    warnings: list[str] = []
    layout = _layout(path, header, parameters, allow_cut, notes, warnings)
    labels = _labels(parameters, layout.points)
    kept = _markers(path, parameters, labels, warnings)
    return Recording(
        path,
        "c3d",
        tuple(labels[i] for i in kept),
        layout.rate_hz,
        layout.frames,
        lambda: _blocks(path, layout, kept),
        tuple(notes),
        tuple(warnings),
        layout.unit,
    )


def _layout(
    path: Path,
    header: Header,
    parameters: Mapping[str, Value],
    allow_cut: bool,
    notes: list[str],
    warnings: list[str],
) -> Layout:
    points = unsigned_parameter(parameters, "POINT:USED") or header.points
    scale = number(parameters, "POINT:SCALE") or header.scale
    rate = number(parameters, "POINT:RATE") or header.rate_hz
    if not points:
        raise fault(path, "holds no 3D points", "Export the markers, not only the analog channels.")
    if not (math.isfinite(scale) and scale != 0 and 0 < rate <= FASTEST_HZ):
        raise fault(path, f"states the scale {scale} and the rate {rate} Hz", BROKEN, byte=12)
    width = 4 if scale < 0 else 2
    words = 4 * points + header.analog_per_frame
    start = ((unsigned_parameter(parameters, "POINT:DATA_START") or header.data_sector) - 1) * SECTOR
    if start < SECTOR:
        raise fault(path, "its data would start inside its header", BROKEN, byte=16)
    frames = _frames(path, _claims(header, parameters), start, words * width, allow_cut, warnings)
    unit = _unit(path, parameters, notes)
    to_mm = SIZES["length"][unit] / SIZES["length"]["mm"] * (1.0 if scale < 0 else scale)
    dtype = np.dtype(f"{header.order}f4") if scale < 0 else np.dtype(f"{header.order}i2")
    return Layout(dtype, points, words, start, frames, to_mm, rate, unit)


def _claims(header: Header, parameters: Mapping[str, Value]) -> list[tuple[str, int]]:
    """What the file says about its number of frames, the most trustworthy first."""
    first, last = (
        unsigned_parameter(parameters, "TRIAL:ACTUAL_START_FIELD"),
        unsigned_parameter(parameters, "TRIAL:ACTUAL_END_FIELD"),
    )
    trial = last - first + 1 if first is not None and last is not None and last != FULL else None
    counted = unsigned_parameter(parameters, "POINT:FRAMES")
    said = {
        "TRIAL:ACTUAL_END_FIELD": trial,
        "POINT:LONG_FRAMES": unsigned_parameter(parameters, "POINT:LONG_FRAMES"),
        "POINT:FRAMES": None if counted == FULL else counted,
        "the header": None if header.last == FULL else header.last - header.first + 1,
    }
    return [(name, value) for name, value in said.items() if value is not None and value > 0]


def _frames(
    path: Path, claims: list[tuple[str, int]], start: int, size: int, allow_cut: bool, warnings: list[str]
) -> int:
    room = max(0, path.stat().st_size - start) // size
    name, frames = claims[0] if claims else ("the file's length", room)
    whole = path.stat().st_size == start + room * size
    if room and room < frames and whole:
        # The header is written first, with the frames that were planned; a copy that broke off ends within a frame.
        warnings.append(f"stopped early: {name} states {frames} frames, the {room} in it are complete and used")
        return room
    if frames > room and allow_cut and room:
        warnings.append(f"cut off: {name} states {frames} frames, the {room} complete ones are used")
        return room
    if frames > room or not frames:
        what = f"is cut off: {name} states {frames} frames ({frames * size} bytes), {room} are there"
        raise fault(path, what, CUT, frame=room + 1)
    odd = next((f"{other} states {count} frames, {name} {frames}" for other, count in claims if count != frames), None)
    if odd:
        warnings.append(f"{odd}: {frames} are taken")
    if not claims:
        warnings.append(f"the counters of frames are full (65535): {frames} frames by the file's length")
    _check_end(path, start + frames * size, warnings)
    return frames


def _check_end(path: Path, end: int, warnings: list[str]) -> None:
    size = path.stat().st_size
    padded = -(-end // SECTOR) * SECTOR
    with path.open("rb") as stream:
        for at in {end, padded}:
            stream.seek(at)
            if is_c3d(stream.read(SECTOR)):
                what = "two recordings are concatenated"
                raise fault(path, what, "Give each recording as a file of its own.", byte=at)
    if size - end >= SECTOR:
        warnings.append(f"{size - end} bytes after the last frame are left out")


def _unit(path: Path, parameters: Mapping[str, Value], notes: list[str]) -> str:
    said = [str(unit) for unit in parameters.get("POINT:UNITS", ()) if unit]
    unit = said[0].lower() if said else "mm"
    unit = {"meters": "m", "metres": "m", "meter": "m", "millimeters": "mm", "in": "inch"}.get(unit, unit)
    if unit not in SIZES["length"]:
        raise fault(path, f"states the unit {unit!r}", f"Export it in {', '.join(SIZES['length'])}.")
    notes.append(f"coordinates in {unit}" + ("" if said else ", which the file does not state"))
    return unit


def _labels(parameters: Mapping[str, Value], points: int) -> tuple[str, ...]:
    said: list[str] = []
    for name in ("POINT:LABELS", "POINT:LABELS2", "POINT:LABELS3"):
        said += [str(label) for label in parameters.get(name, ())]
    return tuple(said[i] if i < len(said) and said[i] else f"Point_{i + 1}" for i in range(points))


def _markers(path: Path, parameters: Mapping[str, Value], labels: Sequence[str], warnings: list[str]) -> list[int]:
    """Return the indices of the points that are places, and say which of the others the file lists as what."""
    groups: dict[str, list[str]] = {}
    for name, values in parameters.items():
        if found := NO_PLACES.fullmatch(name):
            listed = {str(value) for value in values if value}
            groups.setdefault(found[1], []).extend(
                label for label in labels if label in listed or label.rpartition(":")[2] in listed
            )
    others = {label for names in groups.values() for label in names}
    kept = [i for i, label in enumerate(labels) if label not in others]
    if not kept:
        raise fault(
            path, f"holds only {_format_groups(groups)} and no markers", "Export the trajectories of the markers too."
        )
    if others:
        warnings.append(f"{_format_groups(groups)}: left out, for these are not markers")
    return kept


def _format_groups(groups: Mapping[str, Sequence[str]]) -> str:
    return "; ".join(f"{', '.join(names)} of POINT:{group}" for group, names in groups.items() if names)


def _blocks(path: Path, layout: Layout, kept: Sequence[int]) -> Iterator[Block]:
    step = frames_per_block(max(layout.points, layout.words // 4))
    with path.open("rb") as stream:
        stream.seek(layout.start)
        for first in range(0, layout.frames, step):
            count = min(step, layout.frames - first)
            raw = np.fromfile(stream, layout.dtype, count * layout.words)
            if len(raw) < count * layout.words:
                raise fault(path, "became shorter while it was read", BROKEN, frame=first + 1)
            four = raw.reshape(count, layout.words)[:, : 4 * layout.points].reshape(count, layout.points, 4)[:, kept]
            points = four[..., :3].astype(np.float64)
            if layout.to_mm != 1.0:
                points *= layout.to_mm
            index = np.arange(first, first + count)
            yield Block(index / layout.rate_hz, without_gaps(points, four[..., 3].astype(np.float32)), index + 1)


class C3d(RecordingReader):
    """Markers of Optotrak, Qualisys and Vicon."""

    name = "c3d"
    title = "C3D recording of markers (Vicon, Qualisys, Motive, Optotrak)"
    is_a = "a C3D recording"
    endings = (".c3d",)

    def recognises(self, head: Head) -> bool:
        """The second byte, and the number of the block before it; or the ending, so that damage is named."""
        return is_c3d(head.start) or head.ending in self.endings

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_c3d(path, hints.allow_cut), hints.unit)


READER = C3d()
