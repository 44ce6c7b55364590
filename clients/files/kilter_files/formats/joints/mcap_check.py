"""MCAP and SQLite files checked before a library trusts their numbers: cut off, or claiming too much."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, BinaryIO

from kilter_files.ground.faults import fault, read_head
from kilter_files.ground.later import need

MCAP = b"\x89MCAP0\r\n"
SQLITE = b"SQLite format 3\0"
LARGEST_CHUNK = 256 << 20
HEAD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQII")  # first and last time, size unpacked, checksum, length of the compression's name
CHUNK_RECORD, FOOTER_RECORD = 0x06, 0x02
AGAIN = "Recover it with `mcap recover`, or record again and let the recorder end by itself."


def check_mcap(path: Path) -> None:
    """Follow the records from the first to the end and unpack each chunk no further than it says.

    Raises:
        FileError: cut off, glued, or a chunk that unpacks to more than it states or than is sensible.

    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        at = len(MCAP)
        while True:
            stream.seek(at)
            head = stream.read(HEAD.size)
            if len(head) < HEAD.size:
                raise fault(path, "is cut off: its end is missing", AGAIN, byte=at)
            kind, length = HEAD.unpack(head)
            if at + HEAD.size + length > size:
                raise fault(path, f"is cut off: a record states {length} bytes", AGAIN, byte=at)
            if kind == CHUNK_RECORD:
                _check_chunk(path, stream, at, length)
            at += HEAD.size + length
            if kind == FOOTER_RECORD:
                break
        stream.seek(at)
        if stream.read(len(MCAP)) != MCAP or at + len(MCAP) != size:
            raise fault(path, "goes on behind its end: is another file appended to it", AGAIN, byte=at)


def check_sqlite(path: Path) -> None:
    """Compare the size with the pages the file states.

    Raises:
        FileError: cut off.

    """
    head = read_head(path, 100)
    if len(head) < 100:
        raise fault(path, "is cut off", "Copy it again.", byte=len(head))
    page, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
    page = 65536 if page == 1 else page
    size = path.stat().st_size
    if pages and size < page * pages:
        what = f"is cut off: it states {pages} pages ({page * pages} bytes), {size} bytes are there"
        raise fault(path, what, "Copy it again.", byte=size)


def _check_chunk(path: Path, stream: BinaryIO, at: int, length: int) -> None:
    head = stream.read(CHUNK.size)
    if len(head) < CHUNK.size:
        raise fault(path, "a chunk is shorter than its head", AGAIN, byte=at)
    _, _, unpacked, _, named = CHUNK.unpack(head)
    if unpacked > LARGEST_CHUNK:
        what = f"a chunk claims to unpack to {unpacked} bytes"
        raise fault(path, what, f"Record with chunks below {LARGEST_CHUNK >> 20} MB.", byte=at)
    packing = stream.read(min(named, 16)).decode("latin-1")
    stated = stream.read(8)
    if named > 16 or len(stated) < 8:
        raise fault(path, "a chunk has an unknown compression", AGAIN, byte=at)
    packed = struct.unpack("<Q", stated)[0]
    if packed != length - CHUNK.size - named - 8:
        raise fault(path, "a chunk's size is not that of its record", AGAIN, byte=at)
    if _unpacked_size(path, stream.read(packed), packing, unpacked, at) != unpacked:
        raise fault(path, f"a chunk does not unpack to the {unpacked} bytes it states", AGAIN, byte=at)


def _unpacked_size(path: Path, content: bytes, packing: str, limit: int, at: int) -> int:
    """Return how many bytes ``content`` unpacks to, counted no further than one beyond ``limit``."""
    if not packing:
        return len(content)
    unpack = _unpacker(path, packing, at)
    try:
        return len(unpack.decompress(content, limit + 1))
    except Exception as error:  # zstd and lz4 have their own kinds of errors, and RuntimeError
        raise fault(path, f"a chunk cannot be unpacked ({str(error)[:80]})", AGAIN, byte=at) from error


def _unpacker(path: Path, packing: str, at: int) -> Any:
    if packing == "lz4":
        return need(f"{path}: This recording needs", "lz4", "lz4.frame").LZ4FrameDecompressor()
    if packing == "zstd":
        return need(f"{path}: This recording needs", "backports.zstd").ZstdDecompressor()
    raise fault(
        path, f"a chunk is compressed with {packing!r}", "Record with zstd, lz4 or without compression.", byte=at
    )
