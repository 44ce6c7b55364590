"""C3D files of 3D points, as Optotrak, Qualisys and Vicon write them.

Read here and not with a library: one that was tried stops at frame 65 535, takes files that are cut off for whole,
and holds every frame in memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.recordings.c3d_parameters import (
    BROKEN,
    SECTOR,
    Header,
    Value,
    is_c3d,
    number,
    read_header,
    read_parameters,
    unsigned_parameter,
)
from kilter_files.ground.faults import CUT, fault, read_head
from kilter_files.ground.later import np
from kilter_files.ground.units import SIZES
from kilter_files.tables.gaps import without_gaps
from kilter_files.tables.recording import Block, Recording, frames_per_block

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
