"""Orientations that no names tell: columns side by side that are a unit quaternion or a matrix in every row."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_files.formats.unknown.guess import Columns
from kilter_files.ground.units import UNKNOWN

CLOSE = 1e-3  # of the squares of a quaternion or of a matrix's rows to what they should be
FEWEST_ROWS = 3
INDEX = re.compile(r"\d+\W*\Z")
ORDERS = ("wxyz", "xyzw")
Rows = list[tuple[float, ...]]


def bare_matrix(columns: Columns) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], str] | None:
    """Return the nine columns of a rotation, row by row, those of the point, those of the last row, and a remark.

    A pose is sixteen columns with 0, 0, 0, 1, row by row or column by column, or twelve row by row.
    """
    for size in (16, 12):
        for names, rows in _windows(columns, size):
            for across, down in ((1, 4), (4, 1)) if size == 16 else ((1, 4),):
                turn = [down * i + across * j for i in range(3) for j in range(3)]
                last = [3 * down + across * j for j in range(4)] if size == 16 else []
                if _ends_well(rows, last) and all(_is_rotation([row[k] for k in turn]) for row in rows):
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


def _is_rotation(m: Sequence[float]) -> bool:
    sides = (m[:3], m[3:6], m[6:])
    return all(abs(sum(x * y for x, y in zip(a, b, strict=True)) - float(a is b)) < CLOSE for a in sides for b in sides)
