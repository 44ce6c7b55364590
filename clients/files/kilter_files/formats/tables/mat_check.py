"""MATLAB files checked before a library trusts their numbers: cut off, bombs, arrays larger than their bytes."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from kilter_files.ground.faults import fault, read_head

HEAD_BYTES = 128
COMPRESSED, MATRIX = 15, 14
SPARSE = 5
PIECE = 1 << 20
MOST_UNPACKED = 2 << 30
AGAIN = "Save it again in MATLAB with '-v7'."


def check_mat(path: Path) -> None:
    """Follow the variables of a version 5 to 7 file; files of other versions are left to their reader.

    Raises:
        FileError: cut off, a variable that unpacks to more than is sensible, or one larger than its bytes.

    """
    head = read_head(path, HEAD_BYTES)
    if not head.startswith(b"MATLAB 5.0"):
        return
    order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    if order is None:
        raise fault(path, "its header does not say the order of its bytes", AGAIN, byte=126)
    size, at, total = path.stat().st_size, HEAD_BYTES, 0
    with path.open("rb") as stream:
        while at < size:
            stream.seek(at)
            tag = stream.read(8)
            kind, length = struct.unpack(f"{order}II", tag) if len(tag) == 8 else (0, size)
            if at + 8 + length > size:
                raise fault(path, f"is cut off: a variable states {length} bytes", AGAIN, byte=at)
            total += _check(path, stream, kind, length, order, at)
            if total > MOST_UNPACKED:
                raise fault(path, f"unpacks to more than {MOST_UNPACKED >> 30} GB", "Save fewer variables.", byte=at)
            at += 8 + length


def _check(path: Path, stream: BinaryIO, kind: int, length: int, order: str, at: int) -> int:
    """Check one variable and return how many bytes it unpacks to."""
    if kind != COMPRESSED:
        _check_shape(path, stream.read(min(length, 256)), length, order, at)
        return length
    unpack, left, total, head = zlib.decompressobj(), length, 0, b""
    try:
        while left and not unpack.eof and total <= MOST_UNPACKED:
            piece = stream.read(min(PIECE, left))
            left -= len(piece)
            while piece and total <= MOST_UNPACKED:
                found = unpack.decompress(piece, PIECE)
                head += found[: 264 - len(head)]
                total, piece = total + len(found), unpack.unconsumed_tail
    except zlib.error as error:
        raise fault(path, f"a variable cannot be unpacked ({error})", AGAIN, byte=at) from error
    if len(head) >= 8:
        inner, stated = struct.unpack_from(f"{order}II", head)
        if inner == MATRIX and stated + 8 > total:
            raise fault(path, f"a variable states {stated} bytes and unpacks to {total}", AGAIN, byte=at)
        _check_shape(path, head[8:], total, order, at)
    return total


def _check_shape(path: Path, head: bytes, length: int, order: str, at: int) -> None:
    """Refuse a matrix whose shape needs more elements than it has bytes: array flags, then its dimensions."""
    if len(head) < 24:
        return
    _, flag_bytes, flags, _, _, shape_bytes = struct.unpack_from(f"{order}6I", head)
    if flag_bytes != 8 or not 8 <= shape_bytes <= 128 or len(head) < 24 + shape_bytes:
        return
    shape = struct.unpack_from(f"{order}{shape_bytes // 4}i", head, 24)
    if flags & 0xFF != SPARSE and (min(shape) < 0 or math.prod(shape) > length):
        said = " x ".join(map(str, shape))
        raise fault(path, f"a variable claims the shape {said} in {length} bytes", AGAIN, byte=at)
