"""A lab's file through its column map: its columns converted, its further files joined, its rows kept and numbered."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from kilter_files.ground.errors import FileError, fault, number_of_session
from kilter_files.ground.time_stamps import clusters, continuous_seconds, parse_stamp_column, times_of_rows
from kilter_files.ground.units import (
    JOINT,
    MARKER,
    TIMESTAMP,
    Quaternion,
    column_unit,
    converter,
    from_euler,
    from_matrix,
    upright,
)
from kilter_files.maps.column_map import ColumnMap, Keep, Orientation, add_joined, joined_columns
from kilter_files.maps.columns import Column, expand_patterns
from kilter_files.tables.source import Source, TextSource, row_line_numbers
from kilter_files.tables.table import Table

# The table [markers] of a column map: rows that measure one marker each, with a column that names it.
#
# One reflector is moved between nests: every row has its place once, and the nest that it sat in.

NEST = "nest"  # the column while the rows are read; no contract column has that name
PLACE = re.compile(r"([xyz])_(mm|m)")
MOST = 99


def number_nests(source: Source, table: Table, column_map: ColumnMap) -> None:
    """Add the number of each row's marker, in the order of their names or numbers.

    Raises:
        FileError: no place beside it, or more markers than there may be.

    """
    assert column_map.marker is not None
    where = f"{column_map.path}, markers"
    places = {name for name in table.columns if PLACE.fullmatch(name)}
    if len(places) != 3:
        what = "the place of the marker belongs beside it: map x_mm, y_mm and z_mm under [columns]"
        raise FileError(f"{where}: {what}.", file=str(column_map.path), key="markers")
    values, numbers = by_name(source.texts(column_map.marker))
    if len(numbers) > MOST:
        what = (
            f"column {column_map.marker!r} names {len(numbers)} markers, and there may be {MOST}: it is another column"
        )
        raise FileError(f"{where}: {what}.", file=str(column_map.path), key="markers.from")
    table.columns[NEST] = values
    table.notes.append(f"markers from {column_map.marker!r}, one in a row: {describe_numbering(numbers, 'm')}")


def by_name(cells: Sequence[str]) -> tuple[list[float], dict[str, int]]:
    """Numbers from 1 in the order of the names or numbers in the cells, NaN for empty ones; and which name has which."""
    texts = [text.strip() for text in cells]
    named = sorted(set(texts) - {""}, key=lambda text: (len(text) if text.isdecimal() else 0, text))
    numbers = {text: number for number, text in enumerate(named, 1)}
    return [float(numbers.get(text, math.nan)) for text in texts], numbers


def describe_numbering(numbers: Mapping[str, int], prefix: str = "") -> str:
    """Say which of the first names has which number."""
    return ", ".join(f"{prefix}{number} is {text!r}" for text, number in list(numbers.items())[:6])


def spread_nests(table: Table) -> None:
    """Put the place of each row into the columns of its marker; those of the others are empty."""
    numbers = [int(number) for number in table.columns.pop(NEST)]
    for name in [name for name in table.columns if PLACE.fullmatch(name)]:
        values = table.columns.pop(name)
        for marker in range(1, max(numbers, default=0) + 1):
            table.columns[f"m{marker}{name}"] = [
                value if number == marker else math.nan for number, value in zip(numbers, values, strict=True)
            ]


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


LINK = re.compile(r"link\d+_(deg|rad|mm|m)")


def keep_rows(source: Source, table: Table, keep: tuple[Keep, ...], drop_missing: bool) -> None:
    """Keep the rows that meet the conditions and lack nothing.

    Raises:
        FileError: a cell is empty and its row is not to be dropped, or no row is left.

    """
    good = set(table.lines)
    for condition in keep:
        before = len(good)
        good &= _meeting(source, condition)
        if before != len(good):
            table.warnings.append(f"{before - len(good)} rows left out by the condition on {condition.column!r}")
    kept = [i for i, line in enumerate(table.lines) if line in good]
    empty = _empty_cells(table, kept)
    if empty and not drop_missing:
        row, name = min(empty.items())
        place = f"{source.path}, {_row_location(source, table.lines[row])}"
        raise FileError(
            f"{place}: {name} is missing. Fill the cell, or set drop_missing = true under "
            f"[rows] to leave such rows out ({len(empty)} of {len(kept)}).",
            file=str(source.path),
            line=table.lines[row],
            column=name,
        )
    if empty:
        table.warnings.append(f"{len(empty)} rows left out because a value is missing")
        # The arm was there all the same: who derives directions must know that these rows do not follow one another.
        number = {i: float(k) for k, i in enumerate(kept, 1)}
        table.columns.setdefault("row", [number.get(i, math.nan) for i in range(len(table))])
    table.keep([i for i in kept if i not in empty])
    if not len(table):
        raise FileError(f"{source.path}: no row is left. Loosen the conditions under [rows].", file=str(source.path))


def _meeting(source: Source, condition: Keep) -> set[int]:
    """Lines of the rows that meet a condition."""
    if condition.equals:
        good = [text in condition.equals for text in source.texts(condition.column)]
    else:
        low = -math.inf if condition.minimum is None else condition.minimum
        high = math.inf if condition.maximum is None else condition.maximum
        good = [low <= value <= high for value in source.numbers(condition.column)]
    lines = list(zip(row_line_numbers(source, good), good, strict=True))
    return {line for line, is_good in lines if is_good} - {line for line, is_good in lines if not is_good}


def _empty_cells(table: Table, rows: Sequence[int]) -> dict[int, str]:
    """The column of an empty cell by its row; markers may be missing."""
    needed = {name: values for name, values in table.columns.items() if not MARKER.fullmatch(name)}
    return {i: name for name, values in needed.items() for i in rows if math.isnan(values[i])}


def _row_location(source: Source, line: int) -> str:
    return source.row_location(line) if isinstance(source, TextSource) else f"line {line}"


def say_dead(table: Table) -> None:
    """Say which link-side encoders never change though others do: they are not connected."""
    still = {name: len(set(values)) == 1 for name, values in table.columns.items() if LINK.fullmatch(name)}
    dead = [name for name, is_still in still.items() if is_still]
    if dead and len(dead) < len(still):
        one = len(dead) == 1
        table.warnings.append(
            f"{', '.join(dead)} {'is' if one else 'are'} the same in every row: {'a dead channel' if one else 'dead channels'}"
        )


def number_poses(table: Table, tolerance_deg: float) -> None:
    """Rows whose joints agree within the tolerance (1 mm counts as 1 deg) share a pose_id, numbered as they come."""
    labels = []
    for name, values in table.columns.items():
        if JOINT.fullmatch(name):
            convert = converter(column_unit(name) or "", "deg") or converter(column_unit(name) or "", "mm")
            assert convert is not None  # joints are angles or lengths
            labels.append(clusters([convert(value) for value in values], tolerance_deg))
    numbers: dict[tuple[int, ...], int] = {}
    table.columns["pose_id"] = [float(numbers.setdefault(key, len(numbers) + 1)) for key in zip(*labels, strict=True)]
    table.notes.append(f"pose_id: {len(numbers)} poses among {len(table)} rows, by equal joints")


def apply_column_map(source: Source, column_map: ColumnMap, further: Sequence[Source]) -> Table:
    """Return a file in contract columns as ``column_map`` says; ``further`` are the files of its [join] tables.

    Raises:
        FileError: a column that is not there, a cell that is not a number, columns of different lengths, no row left.

    """
    columns = expand_patterns(column_map.columns, source.choices, column_map.path, source.path)
    table = convert_columns(source, columns, column_map.orientation, bare=bool(further))
    if column_map.note:
        table.notes = [column_map.note]
    for join, there in zip(column_map.joins, further, strict=True):
        theirs = convert_columns(there, joined_columns(join, there, column_map.path), join.orientation)
        add_joined(table, source, join, there, theirs, column_map)
    if column_map.marker is not None:
        number_nests(source, table, column_map)
    keep_rows(source, table, column_map.keep, column_map.drop_missing)
    if column_map.marker is not None:
        spread_nests(table)
    say_dead(table)
    if column_map.repeats_deg is not None:
        number_poses(table, column_map.repeats_deg)
    return table
