"""How many pictures an MP4 file holds and how long they run, from its index alone: nothing is decoded."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from kilter_files.ground.faults import fault

INSIDE = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
REMEDY = "It was cut off: record it again, or take the episode out of the data set."


@dataclass(frozen=True)
class Film:
    """Pictures of a video, and for how long they run; 0 s where the file does not say."""

    pictures: int
    seconds: float


def read_video_track(path: Path) -> Film:
    """Return what the first track of video holds.

    Raises:
        FileError: no index, as of a file that was not finished.

    """
    with path.open("rb") as stream:
        size = path.stat().st_size
        moov = next((at for kind, *at in _boxes(stream, 0, size) if kind == b"moov"), None)
        if moov is None:
            raise fault(path, "is an MP4 file without an index", REMEDY)
        for kind, start, end in _boxes(stream, *moov):
            if kind == b"trak" and _handler(stream, start, end) == b"vide":
                count = _samples(stream, start, end)
                if count is not None:
                    return Film(count, _seconds(stream, start, end))
    raise fault(path, "holds no track of video", REMEDY)


def _boxes(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, and where the content begins and ends."""
    while start + 8 <= end:
        stream.seek(start)
        size, kind = struct.unpack(">I4s", stream.read(8))
        head = 8
        if size == 1:
            size, head = struct.unpack(">Q", stream.read(8))[0], 16
        elif size == 0:
            size = end - start
        if size < head or start + size > end:
            return
        yield kind, start + head, start + size
        start += size


def _find(stream: BinaryIO, start: int, end: int, wanted: bytes) -> tuple[int, int] | None:
    for kind, first, last in list(_boxes(stream, start, end)):
        if kind == wanted:
            return first, last
        if kind in INSIDE:
            found = _find(stream, first, last, wanted)
            if found is not None:
                return found
    return None


def _handler(stream: BinaryIO, start: int, end: int) -> bytes:
    at = _find(stream, start, end, b"hdlr")
    if at is None:
        return b""
    stream.seek(at[0] + 8)
    return stream.read(4)


def _samples(stream: BinaryIO, start: int, end: int) -> int | None:
    at = _find(stream, start, end, b"stsz")
    if at is None:
        return None
    stream.seek(at[0] + 8)
    return int(struct.unpack(">I", stream.read(4))[0])


def _seconds(stream: BinaryIO, start: int, end: int) -> float:
    """Duration of a track by its media header, whose second version has longer numbers."""
    at = _find(stream, start, end, b"mdhd")
    if at is None:
        return 0.0
    stream.seek(at[0])
    longer = stream.read(4)[:1] == b"\1"
    stream.seek(at[0] + (20 if longer else 12))
    form = ">IQ" if longer else ">II"
    ticks, duration = struct.unpack(form, stream.read(struct.calcsize(form)))
    return float(duration / ticks) if ticks else 0.0
