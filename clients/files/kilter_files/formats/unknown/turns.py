"""Which columns of an unknown table are an orientation, and in which convention."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from kilter_files.formats.unknown.guess import Columns, name_as_words
from kilter_files.ground.units import SIZES, UNKNOWN

QUATERNIONS: tuple[tuple[str, ...], ...] = (
    ("qw", "qx", "qy", "qz"),
    ("q0", "q1", "q2", "q3"),
    ("quat w", "quat x", "quat y", "quat z"),
)
# names of three angles, in the order of rotation -> the convention of whoever uses these names
ANGLES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("a", "b", "c"), "ZYX", "KUKA's A, B, C"),
    (("w", "p", "r"), "xyz", "FANUC's W, P, R"),
    (("rx", "ry", "rz"), UNKNOWN, ""),
    (("roll", "pitch", "yaw"), UNKNOWN, ""),
)
ASK = 'order of the angles: "XYZ" about the moving axes, "xyz" about the fixed ones, or delete this table'
UNIT = 0.01
LETTER = re.compile(r"(.*[^A-Za-z]|)([wxyzWXYZ])(?:\s*[\[(].*)?")
CELL = re.compile(r"(.*?)([0-4])[_ ,]?([0-4])\W*")  # of a matrix: m03, R_1_2, pose[2,3]

CLOSE = 1e-3  # of the squares of a quaternion or of a matrix's rows to what they should be
FEWEST_ROWS = 3
INDEX = re.compile(r"\d+\W*\Z")
ORDERS = ("wxyz", "xyzw")
Rows = list[tuple[float, ...]]


@dataclass(frozen=True)
class Turned:
    """Columns of an orientation; ``quaternion``, ``euler`` with ``unit``, or ``matrix``.

    Of the pose matrix that holds it ``place`` are the columns of the point, and ``rest`` those of its last row.
    """

    names: tuple[str, ...]
    quaternion: str = ""
    euler: str = ""
    unit: str = ""
    remark: str = ""
    matrix: str = ""
    place: tuple[str, ...] = ()
    rest: tuple[str, ...] = ()

    @property
    def open(self) -> bool:
        """Whether somebody has to fill in what could not be told."""
        return UNKNOWN in (self.euler, self.unit, self.quaternion)


def find_orientation(columns: Columns) -> Turned | None:
    """Return the orientation, None where no columns look like one."""
    words = {name: _strip_unit_and_prefix(name) for name in columns.names}
    for parts in QUATERNIONS:
        names = _match_columns(words, parts)
        if names and _is_unit(columns, names):
            return Turned(names, quaternion="wxyz", remark="four parts of length 1")
    lettered = _find_lettered_quaternion(columns)
    if lettered:
        return Turned(lettered, quaternion="wxyz", remark="four parts of length 1")
    for parts, order, whose in ANGLES:
        names = _match_columns(words, parts)
        if names and columns.largest(names) is not None and columns.unit(names[0]) in (None, *SIZES["angle"]):
            unit, remark = _unit(columns, names)
            told = "; ".join(text for text in (whose, f"{UNKNOWN} {ASK}" if order == UNKNOWN else "", remark) if text)
            return Turned(names, euler=order, unit=unit, remark=told)
    return _matrix(columns) or _bare(columns)


def _bare(columns: Columns) -> Turned | None:
    """An orientation that only its numbers tell: in a table without a header, in arrays, or in cells that are lists."""
    pose = bare_matrix(columns)
    if pose is not None:
        names, place, rest, remark = pose
        return Turned(names, matrix="rows", remark=remark, place=place, rest=rest)
    found = bare_quaternion(columns)
    if found is None:
        return None
    names, place, order, remark = found
    return Turned(names, quaternion=order, remark=remark, place=place)


def _find_lettered_quaternion(columns: Columns) -> tuple[str, ...]:
    """Four columns of length 1 that are alike but for the letters w, x, y and z at their ends."""
    stems: dict[str, dict[str, str]] = {}
    for name in columns.names:
        found = LETTER.fullmatch(name)
        if found:
            stems.setdefault(found[1], {})[found[2].lower()] = name
    for parts in stems.values():
        names = tuple(parts.get(letter, "") for letter in "wxyz")
        if all(names) and _is_unit(columns, names):
            return names
    return ()


def _matrix(columns: Columns) -> Turned | None:
    """Nine numbered columns that are a rotation in every row: m00 to m22, or r11 to r33; with m03, m13, m23 a pose."""
    for cells in _by_prefix(columns.names).values():
        first = 0 if (0, 0) in cells else 1
        turn, across = range(first, first + 3), first + 3
        names = tuple(cells.get((i, j), "") for i in turn for j in turn)
        if all(names) and _is_rotation(columns, names):
            place = tuple(cells.get((i, across), "") for i in turn)
            rest = tuple(name for (i, _), name in cells.items() if i == across)
            known = all(place) and columns.largest(place) is not None
            remark = "nine numbers that are a rotation in every row"
            return Turned(names, matrix="rows", remark=remark, place=place if known else (), rest=rest)
    return None


def _by_prefix(names: Sequence[str]) -> dict[str, dict[tuple[int, int], str]]:
    out: dict[str, dict[tuple[int, int], str]] = {}
    for name in names:
        found = CELL.fullmatch(name) or CELL.fullmatch(re.sub(r"\s*[\[(].*$", "", name))
        if found:
            out.setdefault(found[1], {})[int(found[2]), int(found[3])] = name
    return out


def _is_rotation(columns: Columns, names: Sequence[str]) -> bool:
    values = [columns.numbers(name) or [] for name in names]
    if len({len(column) for column in values}) != 1 or not values[0]:
        return False
    return all(_orthonormal(row) for row in zip(*values, strict=True))


def _orthonormal(m: Sequence[float]) -> bool:
    sides = (m[:3], m[3:6], m[6:])
    return all(abs(sum(x * y for x, y in zip(a, b, strict=True)) - float(a is b)) < UNIT for a in sides for b in sides)


def _strip_unit_and_prefix(name: str) -> str:
    """A name without its unit and without words that every column has."""
    said = re.sub(r"\s*[\[(].*$|_(?:deg|rad)$", "", name)
    return re.sub(r"^(?:tcp|tool|pose|meas\w*|act\w*|rot|orientation|quat\w*(?= ?q))\b\s*", "", name_as_words(said))


def _match_columns(words: dict[str, str], parts: tuple[str, ...]) -> tuple[str, ...]:
    names = [
        next((name for name, said in words.items() if said in (part, part.replace(" ", ""))), "") for part in parts
    ]
    return tuple(names) if all(names) else ()


def _is_unit(columns: Columns, names: tuple[str, ...]) -> bool:
    values = [columns.numbers(name) or [] for name in names]
    if len({len(column) for column in values}) != 1 or not values[0]:
        return False
    return all(abs(sum(v * v for v in row) - 1.0) < UNIT for row in zip(*values, strict=True))


def _unit(columns: Columns, names: tuple[str, ...]) -> tuple[str, str]:
    stated = columns.unit(names[0])
    if stated is not None:
        return stated, ""
    size = columns.largest(names) or 0.0
    if size > 6.6:
        return "deg", f"no unit stated; up to {size:.4g}: degrees"
    return ("rad", f"no unit stated; up to {size:.4g}: radians, check") if size > 0.3 else (UNKNOWN, "deg or rad")


def bare_matrix(columns: Columns) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], str] | None:
    """Return the nine columns of a rotation, row by row, those of the point, those of the last row, and a remark.

    A pose is sixteen columns with 0, 0, 0, 1, row by row or column by column, or twelve row by row.
    """
    for size in (16, 12):
        for names, rows in _windows(columns, size):
            for across, down in ((1, 4), (4, 1)) if size == 16 else ((1, 4),):
                turn = [down * i + across * j for i in range(3) for j in range(3)]
                last = [3 * down + across * j for j in range(4)] if size == 16 else []
                if _ends_well(rows, last) and all(_is_bare_rotation([row[k] for k in turn]) for row in rows):
                    place = tuple(names[down * i + 3 * across] for i in range(3))
                    how = "row by row" if across == 1 else "column by column"
                    rest = tuple(names[k] for k in last)
                    return (
                        tuple(names[k] for k in turn),
                        place,
                        rest,
                        f"{size} numbers that are a pose in every row, {how}",
                    )
    return None


def bare_quaternion(columns: Columns) -> tuple[tuple[str, ...], tuple[str, ...], str, str] | None:
    """Return the four columns of a quaternion, those of a point before it, the order of its parts, and a remark."""
    found = [
        names
        for names, rows in _windows(columns, 4)
        if len(set(rows)) > 1 and all(abs(sum(v * v for v in row) - 1.0) < CLOSE for row in rows)
    ]
    if len(found) != 1:
        return None
    names = found[0]
    before = columns.names[: columns.names.index(names[0])][-3:]
    beside = [name for name in before if _stem(name) == _stem(names[0]) and columns.numbers(name)]
    said = "".join(re.findall(r"[a-z]", names[0].lower()))
    order = next((one for one in ORDERS if one in said), UNKNOWN)
    ask = "" if order != UNKNOWN else f'; {UNKNOWN} order of its parts: "wxyz", or "xyzw" as ROS and scipy have it'
    return names, tuple(beside) if len(beside) == 3 else (), order, f"four numbers of length 1 in every row{ask}"


def _windows(columns: Columns, size: int) -> list[tuple[tuple[str, ...], Rows]]:
    """Columns side by side that are numbered: of a table without a header, an array, or cells that are lists."""
    out = []
    names = columns.names
    for first in range(len(names) - size + 1):
        window = tuple(names[first : first + size])
        if len({_stem(name) for name in window}) != 1 or not INDEX.search(window[0]):
            continue
        values = [columns.numbers(name) or [] for name in window]
        if len(values[0]) >= FEWEST_ROWS and len({len(column) for column in values}) == 1:
            out.append((window, list(zip(*values, strict=True))))
    return out


def _stem(name: str) -> str:
    return INDEX.sub("", name)


def _ends_well(rows: Rows, last: Sequence[int]) -> bool:
    """Whether the last row of each matrix is 0, 0, 0, 1; there is none where ``last`` is empty."""
    return not last or all([row[k] for k in last] == [0.0, 0.0, 0.0, 1.0] for row in rows)


def _is_bare_rotation(m: Sequence[float]) -> bool:
    sides = (m[:3], m[3:6], m[6:])
    return all(abs(sum(x * y for x, y in zip(a, b, strict=True)) - float(a is b)) < CLOSE for a in sides for b in sides)
