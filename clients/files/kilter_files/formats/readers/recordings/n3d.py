"""NDI's floating-point recordings."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.reader import NO_HINTS, Head, Hints, RecordingReader
from kilter_files.ground.errors import CUT, fault, read_head
from kilter_files.ground.later import np
from kilter_files.tables.recording import Block, Recording, frames_per_block, in_stated_unit, without_gaps

if TYPE_CHECKING:
    from kilter_files.tables.recording import Recording

HEADER_BYTES = 256
HEAD = struct.Struct("<BhhifI")  # type, items, numbers per item, frames, rate; the rest is text
MAGIC = 32
FASTEST_HZ = 20_000.0


def is_n3d(head: bytes) -> bool:
    """Tell whether a file's first bytes are an NDI floating-point header of three-dimensional markers."""
    if len(head) < HEAD.size or head[0] != MAGIC:
        return False
    _, items, parts, frames, rate, _ = HEAD.unpack_from(head)
    return items > 0 and parts in (1, 3, 6, 7) and frames > 0 and 0 < rate <= FASTEST_HZ


def read_n3d(path: Path, allow_cut: bool = False) -> Recording:
    """Read an NDI floating-point file; with ``allow_cut`` one that ends before the frames it states.

    Raises:
        FileError: another file, one that is cut off or too long, or one of something else than 3D markers.

    """
    head = read_head(path, HEADER_BYTES)
    if len(head) < HEADER_BYTES or not is_n3d(head):
        raise fault(
            path,
            "is not an NDI floating-point file",
            "Export it as '3D data, floating point' or as C3D or CSV.",
            byte=0,
        )
    _, items, parts, frames, rate, _ = HEAD.unpack_from(head)
    if parts != 3:
        raise fault(path, f"holds {parts} numbers per marker, not x, y, z", "Convert the raw data to 3D first.", byte=3)
    warnings: list[str] = []
    frames = _frames(path, items, frames, allow_cut, warnings)
    return Recording(
        path,
        "n3d",
        tuple(f"Marker_{i}" for i in range(1, items + 1)),
        float(rate),
        frames,
        lambda: _blocks(path, items, frames, float(rate)),
        ("coordinates in mm, as NDI writes them",),
        tuple(warnings),
    )


def _frames(path: Path, items: int, frames: int, allow_cut: bool, warnings: list[str]) -> int:
    wanted, size = HEADER_BYTES + 12 * items * frames, path.stat().st_size
    there = (size - HEADER_BYTES) // (12 * items)
    if size < wanted and allow_cut and there:
        warnings.append(f"cut off: the header states {frames} frames, the {there} complete ones are used")
        return there
    if size < wanted:
        what = f"is cut off: the header states {frames} frames of {items} markers ({wanted} bytes), {there} are there"
        raise fault(path, what, CUT, frame=there + 1)
    if size > wanted:
        with path.open("rb") as stream:
            stream.seek(wanted)
            more = is_n3d(stream.read(HEADER_BYTES))
        what = "two recordings are concatenated" if more else f"has {size - wanted} bytes more than its header states"
        raise fault(path, f"{what}, after frame {frames}", "Give each recording as a file of its own.", byte=wanted)
    return frames


def _blocks(path: Path, items: int, frames: int, rate: float) -> Iterator[Block]:
    step = frames_per_block(items)
    with path.open("rb") as stream:
        stream.seek(HEADER_BYTES)
        for first in range(0, frames, step):
            count = min(step, frames - first)
            raw = np.fromfile(stream, "<f4", 3 * items * count)
            if len(raw) < 3 * items * count:
                raise fault(path, "became shorter while it was read", CUT, frame=first + 1)
            number = np.arange(first, first + count)
            points = without_gaps(raw.reshape(count, items, 3).astype(np.float64))
            yield Block(number / rate, points, number + 1)


class N3d(RecordingReader):
    """Markers of an Optotrak."""

    name = "n3d"
    title = "NDI's floating-point recording (Optotrak)"
    is_a = "a recording of NDI's"
    endings = (".n3d",)

    def recognises(self, head: Head) -> bool:
        """The numbers of its header; or the ending, so that damage is named."""
        return (b"\0" in head.start and is_n3d(head.start)) or head.ending in self.endings

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_n3d(path, hints.allow_cut), hints.unit)


READER = N3d()
