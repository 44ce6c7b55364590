"""The columns of one file in the contract's names and units."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from kilter_files.ground.errors import FileError
from kilter_files.ground.faults import fault
from kilter_files.ground.orientation import Quaternion, from_euler, from_matrix, upright
from kilter_files.ground.session_names import number_of_session
from kilter_files.ground.time_stamps import continuous_seconds, parse_stamp_column, times_of_rows
from kilter_files.ground.units import TIMESTAMP, column_unit, converter
from kilter_files.maps.columns import Column
from kilter_files.maps.nests import describe_numbering
from kilter_files.maps.orientation import Orientation
from kilter_files.tables.source import Source, row_line_numbers
from kilter_files.tables.table import Table

TIME, SET_BACK = "t_s", 0.02  # share of rows at which a clock goes back, above which rows are sorted by something else
SESSION, POSE, NUMBER = "session", "pose_id", re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?")
QUATERNION = ("qw", "qx", "qy", "qz")


def convert_columns(
    source: Source, columns: Sequence[Column], orientation: Orientation | None, bare: bool = False
) -> Table:
    """Return the columns of a file as the map says, with a note on each; ``bare``: it may give rows alone.

    Raises:
        FileError: a column that is not there, a cell that is not a number, columns of different lengths, no row.

    """
    measured = {c.target: _convert(c, source) for c in columns if c.source is not None}
    if orientation:
        measured |= _orientation(source, orientation)
    table = _table(source, measured, bare)
    table.columns |= {c.target: [c.value] * len(table) for c in columns if c.value is not None}
    table.notes += [_understood(column, source) for column in columns]
    table.warnings += _clock_set_back(columns, table)
    return table


def _clock_set_back(columns: Sequence[Column], table: Table) -> list[str]:
    """Name the row at which a clock goes back; rows that are sorted by something else go back often, and are not named."""
    if not any(column.target == TIME and column.unit == TIMESTAMP for column in columns):
        return []
    t = table.columns[TIME]
    falls = [row for row in range(1, len(t)) if t[row] < t[row - 1]]
    if not falls or len(falls) > max(1.0, SET_BACK * len(t)):
        return []
    line, back = table.lines[falls[0]], t[falls[0] - 1] - t[falls[0]]
    more = f" and in {len(falls) - 1} more rows" if len(falls) > 1 else ""
    return [
        f"the clock goes back by {back:.3g} s at line {line}{more}: laws of time cannot be told there. Was it set? Upload "
        "the rows before and after it as two files"
    ]


def _convert(column: Column, source: Source) -> list[float]:
    assert column.source is not None
    if column.unit == TIMESTAMP:
        texts = source.texts(column.source)
        stamps = parse_stamp_column(texts, source.lines, source.path, column.source, column.date_format)
        return times_of_rows(continuous_seconds(stamps)) if stamps else []
    numbers = _numbers_of_names(column, source)
    if numbers:
        return [float(numbers.get(cell.strip(), math.nan)) for cell in source.texts(column.source)]
    convert = converter(column.unit, column_unit(column.target) or "")
    assert convert is not None  # the map was checked when it was read
    values = [convert(column.scale * value + column.offset) for value in source.numbers(column.source)]
    return values if column.still_below is None else _directions(values, column.still_below)


def _numbers_of_names(column: Column, source: Source) -> dict[str, int]:
    """Return the numbers of sessions or poses that have names, empty for any other column.

    One name has the same number in every file: rows of two files may share a session, or a pose. A session's cells are names
    only, of poses some may be.
    """
    if column.target not in (SESSION, POSE) or column.source is None:
        return {}
    cells = dict.fromkeys(filter(None, map(str.strip, source.texts(column.source))))
    numeric = [NUMBER.fullmatch(cell) is not None for cell in cells]
    if all(numeric) if column.target == POSE else any(numeric):
        return {}
    return {cell: number_of_session(cell) for cell in cells}


def _directions(speeds: list[float], still_below: float) -> list[float]:
    """Signs of speeds; a joint that stands keeps the direction it came from, 0 before it first moved."""
    out, last = [], 0.0
    for speed in speeds:
        if abs(speed) > still_below:
            last = math.copysign(1.0, speed)
        out.append(math.nan if math.isnan(speed) else last)
    return out


def _understood(column: Column, source: Source) -> str:
    if column.value is not None:
        return f"{column.target} = {column.value:g} in every row"
    turned = f" x {column.scale:g}" if column.scale != 1 else ""
    shifted = f" {column.offset:+g}" if column.offset else ""
    numbers = _numbers_of_names(column, source)
    numbered = f": {describe_numbering(numbers)}" if numbers else ""
    unit = f" [{column.unit}]" if column.unit else ""
    return f"{column.target} from {column.source!r}{turned}{shifted}{unit}{numbered}"


def _table(source: Source, measured: dict[str, list[float]], bare: bool) -> Table:
    lengths = {name: len(values) for name, values in measured.items()}
    if len(set(lengths.values())) > 1:
        different = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise FileError(
            f"{source.path}: the columns have different numbers of rows ({different}).", file=str(source.path)
        )
    first = next(iter(measured.values()), source.lines if bare else [])
    if not first:
        what = "no rows, or a map of constants only. Map at least the joints"
        raise FileError(f"{source.path}: {what}.", file=str(source.path))
    return Table(measured, list(row_line_numbers(source, first)))


def _orientation(source: Source, orientation: Orientation) -> dict[str, list[float]]:
    parts = list(zip(*(source.numbers(name) for name in orientation.sources), strict=True))
    if len(orientation.sources) == 9:
        lines = row_line_numbers(source, parts)
        turned = [_of_matrix(p, orientation.order, source.path, line) for p, line in zip(parts, lines, strict=True)]
    elif len(orientation.sources) == 4:
        order = [orientation.order.index(axis) for axis in "wxyz"]
        turned = [upright((p[order[0]], p[order[1]], p[order[2]], p[order[3]])) for p in parts]
    else:
        convert = converter(orientation.unit, "rad")
        assert convert is not None  # the map was checked when it was read
        turned = [from_euler((convert(a), convert(b), convert(c)), orientation.order) for a, b, c in parts]
    return {name: [quaternion[i] for quaternion in turned] for i, name in enumerate(QUATERNION)}


def _of_matrix(parts: tuple[float, ...], order: str, path: Path, line: int) -> Quaternion:
    found = from_matrix(parts, order)
    if found is None:
        shape = "rows of length 1, at right angles, right-handed"
        what = f"the nine columns of the orientation are not a rotation matrix ({shape})"
        raise fault(path, what, 'Check their order and matrix = "rows" or "columns".', line=line)
    return found
