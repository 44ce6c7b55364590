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
from dataclasses import dataclass
from functools import cache

import numpy as np

from kilter_core.arm.load_wrenches import HANGING_ROUNDS, SIDED_ROUNDS
from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionProgram
from kilter_core.errors import OptionError
from kilter_core.types import Floats

MAGIC, FORMAT = b"KLTC", 1
HEADER = struct.Struct("<4sIIIIIIIQ40s48s")
VERSION_BYTES, ROBOT_BYTES = 40, 48
CRC_AT = 28
MOST_JOINTS, MOST_MOVES, MOST_ROWS, MOST_ROUNDS = 16, 64, 1024, 1000
_AGAIN = "export the version again with `kilter version export --format corrector`."
_OF_ONE = "export the version again from a server of this release, or install the release that wrote it."


@dataclass(frozen=True)
class Stored:
    """A program as its file has it, with the version and the robot that it names."""

    program: CorrectionProgram
    version_id: str
    number: int
    robot: str


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


def from_bytes(content: bytes) -> Stored:
    """Read a program as :func:`to_bytes` writes it. Which effects it holds, a file does not say.

    Raises:
        OptionError: it is cut off, altered, of another release, or its numbers are those of no arm.

    """
    if len(content) < HEADER.size:
        raise _program_error("is cut off")
    magic, form, header, layout_of, rows, columns, joints, crc, number, version_id, robot = HEADER.unpack_from(content)
    if magic != MAGIC or header != HEADER.size:
        raise _program_error("is none")
    if form > FORMAT or layout_of != layout_digest() or columns != layout.COLUMNS:
        newer = f", which writes format {form}" if form > FORMAT else ""
        raise _program_error(f"is of another release of Kilter{newer}", _OF_ONE)
    if not (4 <= rows <= MOST_ROWS and 1 <= joints <= MOST_JOINTS):
        raise _program_error("has the numbers of no arm")
    if len(content) != HEADER.size + 8 * rows * columns:
        raise _program_error("is cut off, or goes on behind its end")
    zero = content[:CRC_AT] + bytes(4) + content[CRC_AT + 4 : HEADER.size]
    if checksum(zero, content[HEADER.size :]) != crc:
        raise _program_error("was altered on its way, its checksum is wrong")
    array = np.frombuffer(content, "<f8", offset=HEADER.size).reshape(rows, columns).astype(np.float64)
    if not _possible(array, joints):
        raise _program_error("has the numbers of no arm")
    scalars = array[-1]
    program = CorrectionProgram(array, joints, int(scalars[layout.M]), int(scalars[layout.FIRST]), (), ())
    return Stored(program, _text(version_id), number, _text(robot))


def _program_error(what: str, remedy: str | None = None) -> OptionError:
    return OptionError(f"This program of a corrector {what}: {remedy or _AGAIN}", option="program")


def _text(padded: bytes) -> str:
    return padded.rstrip(b"\0").decode(errors="replace")


def _possible(array: Floats, n: int) -> bool:
    """Whether every place that the kernels go by lies within the program, so that no number leads out of the memory."""
    if np.isnan(array).any():
        return False
    last, scalars = len(array) - 1, array[-1]
    wanted = {
        layout.N: (n, n),
        layout.M: (1, MOST_MOVES),
        layout.CURVES: (0, MOST_ROWS),
        layout.BENDINGS: (0, MOST_ROWS),
        layout.LOAD_CHAIN: (0, MOST_ROWS),
        layout.DOUBT_AT: (0, MOST_ROWS),
        layout.DOUBTS: (0, MOST_ROWS),
        layout.ITERATIONS: (1, MOST_ROUNDS),
        layout.ROUNDS: (1, MOST_ROUNDS),
        layout.ROWS: (5, 6),
        layout.FIRST: (3, 6),
        layout.HANGING: (0, HANGING_ROUNDS),
        layout.HANGING_SIDED: (0, SIDED_ROUNDS),
    }
    if not all(_whole(scalars[column], *bounds) for column, bounds in wanted.items()):
        return False
    m, curves, bendings, loads = (
        int(scalars[column]) for column in (layout.M, layout.CURVES, layout.BENDINGS, layout.LOAD_CHAIN)
    )
    mount = int(scalars[layout.MOUNT] != 0.0)
    bent = m + 1 + n + curves
    if scalars[layout.FIRST] > scalars[layout.ROWS] or bent + 2 * bendings + mount > last:
        return False
    if (loads and loads + m + 1 + mount > last) or scalars[layout.DOUBT_AT] + scalars[layout.DOUBTS] > last:
        return False
    joints, curve_rows, bending_rows = array[m + 1 : m + 1 + n], array[m + 1 + n : bent], array[bent::2][:bendings]
    return bool(
        _whole(array[:m, layout.JOINT], 0, n - 1)
        and (joints[:, [layout.LARGEST, layout.RATE]] > 0.0).all()
        and _whole(curve_rows[:, [layout.CURVED, layout.DRIVER]], 0, n - 1)
        and _whole(curve_rows[:, layout.MOVED], 0, 6)
        and _whole(bending_rows[:, layout.BENDING_JOINT], 0, n - 1)
        and _whole(bending_rows[:, layout.POWER], 0, 3)
        and _whole(bending_rows[:, layout.OF_AXIS], 0, 6)
    )


def _whole(values: Floats, least: int, most: int) -> bool:
    """Whether numbers are whole ones from ``least`` to ``most``."""
    return bool(((values >= least) & (values <= most) & (values == np.floor(values))).all())
