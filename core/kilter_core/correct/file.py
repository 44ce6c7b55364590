"""A correction as a file: the program of the kernels under a header that says what it is and whether it is whole.

The C corrector (clients/c) loads it, and a controller that has no Python needs nothing else. All numbers little-endian:

====== ===== ==========================================================================
offset bytes content
====== ===== ==========================================================================
0      4     ``KLTC``
4      4     format, 1
8      4     bytes of the header, 128
12     4     layout: changes with the meaning of any number of the program
16     4     rows of the program
20     4     columns, 48
24     4     joints
28     4     CRC-32 (IEEE 802.3) of the whole file with these four bytes zero
32     8     number of the version that the messages of a stream carry
40     40    id of the version, UTF-8, padded with zeros
80     48    name of the robot, the same
128    8     each number of the program, float64, row by row
====== ===== ==========================================================================
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from functools import cache

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram
from kilter_core.errors import OptionError

MAGIC, FORMAT = b"KLTC", 1
HEADER = struct.Struct("<4sIIIIIIIQ40s48s")
VERSION_BYTES, ROBOT_BYTES = 40, 48


@cache
def layout_digest() -> int:
    """32 bits that change with any number of the layout: code for another one refuses the program."""
    numbers = sorted((name, value) for name, value in vars(layout).items() if name.isupper())
    return int.from_bytes(hashlib.sha256(repr(numbers).encode()).digest()[:4], "little")


def to_bytes(program: CorrectionProgram, *, version_id: str, number: int, robot: str) -> bytes:
    """Write a program as a file.

    Args:
        program: as :func:`kilter_core.correct.program.compile_program` makes it.
        version_id: id of the version it is made of, up to 40 bytes of UTF-8.
        number: of that version in the messages of a stream, 64 bits.
        robot: name of the robot; beyond 48 bytes of UTF-8 it is cut.

    Raises:
        OptionError: the id does not fit.

    """
    if len(version_id.encode()) > VERSION_BYTES:
        raise OptionError(f"The id {version_id!r} has more than {VERSION_BYTES} bytes.", option="version_id")
    rows, columns = program.array.shape
    name = robot.encode()[:ROBOT_BYTES].decode(errors="ignore").encode()
    fields = (MAGIC, FORMAT, HEADER.size, layout_digest(), rows, columns, program.n_joints)
    texts = (number, version_id.encode(), name)
    numbers = program.array.astype("<f8").tobytes()
    crc = checksum(HEADER.pack(*fields, 0, *texts), numbers)
    return HEADER.pack(*fields, crc, *texts) + numbers


def checksum(header: bytes, numbers: bytes) -> int:
    """CRC-32 of a file whose header has zero in its place."""
    return zlib.crc32(numbers, zlib.crc32(header))
