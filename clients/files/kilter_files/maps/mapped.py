"""A lab's file through its column map: contract columns, converted and counted."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence, Sized
from pathlib import Path
from shlex import quote

from kilter_files.ground.clusters import clusters
from kilter_files.ground.errors import FileError
from kilter_files.ground.faults import fault
from kilter_files.ground.orientation import Quaternion, from_euler, from_matrix, upright
from kilter_files.ground.time_stamps import seconds_of, stamps_of
from kilter_files.ground.units import MARKER, TIMESTAMP, converter, unit_of
from kilter_files.maps.column_map import ColumnMap, Keep
from kilter_files.maps.columns import Column, expanded
from kilter_files.maps.join import Join, partners, refuse_alone
from kilter_files.maps.nests import by_name, number_nests, spread_nests, told
from kilter_files.maps.orientation import Orientation
from kilter_files.tables.source import Source
from kilter_files.tables.table import Table
from kilter_files.tables.text_source import TextSource

PLAIN_JOINT = re.compile(r"q\d+")
JOINT = re.compile(r"q\d+_(deg|rad|mm|m)")
LINK = re.compile(r"link\d+_(deg|rad|mm|m)")
SESSION, NUMBER = "session", re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?")
QUATERNION = ("qw", "qx", "qy", "qz")


def mapped(source: Source, column_map: ColumnMap, further: Sequence[Source]) -> Table:
    """Return a file in contract columns as ``column_map`` says; ``further`` are the files of its [join] tables.

    Raises:
        FileError: a column that is not there, a cell that is not a number, columns of different lengths, no row left.

    """
    columns = expanded(column_map.columns, source.choices, column_map.path, source.path)
    measured = {c.target: _convert(c, source) for c in columns if c.source is not None}
    if column_map.orientation:
        measured |= _orientation(source, column_map.orientation)
    table = _table(source, measured, bool(further))
    table.notes += [_understood(column, source) for column in columns]
    for column in columns:
        if column.value is not None:
            table.columns[column.target] = [column.value] * len(table)
    for join, there in zip(column_map.joins, further, strict=True):
        _add_columns(source, table, column_map, join, there)
    if column_map.marker is not None:
        number_nests(source, table, column_map)
    _keep_rows(source, table, column_map.keep, column_map.drop_missing)
    if column_map.marker is not None:
        spread_nests(table)
    _dead(table)
    if column_map.repeats_deg is not None:
        _number_poses(table, column_map.repeats_deg)
    return table


def contract_table(source: Source) -> Table:
    """Return a workbook whose columns are the contract's already.

    Raises:
        FileError: other columns; the remedy is a map.

    """
    odd = [name for name in source.choices if name and unit_of(name) is None]
    columns = _contract(source)
    if odd or not columns:
        said = ", ".join(map(repr, odd[:6])) or "none has a name"
        raise FileError(
            f"{source.path}: not all of its columns are the contract's: {said}. Write a column map "
            f"(`kilter inspect {quote(str(source.path))} --draft columns.toml`) and give it with --map.",
            file=str(source.path),
        )
    table = _table(source, {c.target: _convert(c, source) for c in columns})
    table.notes.append("contract columns of the workbook's first sheet")
    _keep_rows(source, table, (), drop_missing=False)
    return table


def further_files(path: Path, column_map: ColumnMap, named: Path | None) -> list[Path]:
    """Return the file of each [join] of a map: that of the first as named, else the map's, beside the file or the map.

    Raises:
        FileError: a file is named for a map without [join], or there is none for a map with one.

    """
    if named is not None and not column_map.joins:
        raise FileError(
            f"{column_map.path}: does not say how rows of {named} belong to those of {path}. Add a table [join], for example "
            'by = "row".',
            file=str(column_map.path),
        )
    joins = column_map.joins if named is None else column_map.joins[1:]
    return [*([] if named is None else [named]), *(_file_of(join, path, column_map) for join in joins)]


def _file_of(join: Join, path: Path, column_map: ColumnMap) -> Path:
    remedy = "or name it with --joints" if join is column_map.joins[0] else "as --joints names the first"
    place = f"{join.place}.path"
    if join.path is None:
        what = f"{column_map.path}, {join.place}: names no second file. Give 'path', {remedy}."
        raise FileError(what, file=str(column_map.path), key=place)
    places = [folder / join.path for folder in (path.parent, column_map.path.parent)]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        what = f"{column_map.path}, {place}: there is no file {places[0]}. Correct 'path', {remedy}."
        raise FileError(what, file=str(column_map.path), key=place)
    return found


def _add_columns(source: Source, table: Table, column_map: ColumnMap, join: Join, there: Source) -> None:
    """Add the columns of a further file, row for row."""
    files = source.path, there.path
    columns = expanded(
        _contract(there) if join.columns is None else join.columns, there.choices, column_map.path, there.path
    )
    found = {c.target: _convert(c, there) for c in columns if c.source is not None}
    if join.orientation:
        found |= _orientation(there, join.orientation)
    twice = sorted(set(found) & set(table.columns))
    if twice or not found:
        what = (
            f"{twice[0]} comes from {there.path.name} and from a file before it"
            if twice
            else f"{there.path} gives no contract column: add [join.columns]"
        )
        raise FileError(
            f"{column_map.path}, {join.place}: {what}.", file=str(column_map.path), key=f"{join.place}.columns"
        )
    theirs = _table(there, found)
    rows = partners(join, source, there, (len(table), len(theirs)))
    if not column_map.drop_missing:
        refuse_alone(join, rows, table.lines, files)
    table.columns |= {
        name: [math.nan if row is None else values[row] for row in rows] for name, values in found.items()
    }
    table.notes += [f"{_understood(column, there)}, of {there.path.name} by {join.by}" for column in columns]
    idle = len(theirs) - len({row for row in rows if row is not None})
    table.warnings += [f"{idle} rows of {there.path.name} have no partner and are left out"] if idle else []


def _contract(there: Source) -> tuple[Column, ...]:
    """Columns whose names are the contract's; a program's targets are in degrees."""
    named = [(name, unit_of(name)) for name in there.choices]
    plain = tuple(Column(name, name, unit) for name, unit in named if unit is not None)
    return plain or tuple(Column(f"{name}_deg", name, "deg") for name in there.choices if PLAIN_JOINT.fullmatch(name))


def _convert(column: Column, source: Source) -> list[float]:
    assert column.source is not None
    if column.unit == TIMESTAMP:
        texts = source.texts(column.source)
        seconds = seconds_of(stamps_of(texts, source.lines, source.path, column.source))
        return [t - seconds[0] for t in seconds]
    names = _session_names(column, source)
    if names is not None:
        return by_name(names)[0]
    convert = converter(column.unit, unit_of(column.target) or "")
    assert convert is not None  # the map was checked when it was read
    values = [convert(column.scale * value + column.offset) for value in source.numbers(column.source)]
    return values if column.still_below is None else _directions(values, column.still_below)


def _session_names(column: Column, source: Source) -> list[str] | None:
    """Cells of sessions that have names, none a number; None for any other column."""
    if column.target != SESSION or column.source is None:
        return None
    cells = source.texts(column.source)
    return None if any(NUMBER.fullmatch(cell.strip()) for cell in cells) or not any(map(str.strip, cells)) else cells


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
    names = _session_names(column, source)
    numbered = "" if names is None else f": {told(by_name(names)[1])}"
    unit = f" [{column.unit}]" if column.unit else ""
    return f"{column.target} from {column.source!r}{turned}{shifted}{unit}{numbered}"


def _table(source: Source, measured: dict[str, list[float]], joined: bool = False) -> Table:
    lengths = {name: len(values) for name, values in measured.items()}
    if len(set(lengths.values())) > 1:
        different = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise FileError(
            f"{source.path}: the columns have different numbers of rows ({different}).", file=str(source.path)
        )
    rows = next(iter(lengths.values()), len(source.lines) if joined else 0)
    if not rows:
        what = "no rows, or a map of constants only. Map at least the joints"
        raise FileError(f"{source.path}: {what}.", file=str(source.path))
    return Table(measured, source.lines or list(range(1, rows + 1)))


def _orientation(source: Source, orientation: Orientation) -> dict[str, list[float]]:
    parts = list(zip(*(source.numbers(name) for name in orientation.sources), strict=True))
    if len(orientation.sources) == 9:
        lines = _all_lines(source, parts)
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


def _keep_rows(source: Source, table: Table, keep: tuple[Keep, ...], drop_missing: bool) -> None:
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
        place = f"{source.path}, {_at(source, table.lines[row])}"
        raise FileError(
            f"{place}: {name} is missing. Fill the cell, or set drop_missing = true under "
            f"[rows] to leave such rows out ({len(empty)} of {len(kept)}).{getattr(source, 'empty_hint', '')}",
            file=str(source.path),
            line=table.lines[row],
            column=name,
        )
    if empty:
        table.warnings.append(f"{len(empty)} rows left out because a value is missing")
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
    lines = list(zip(_all_lines(source, good), good, strict=True))
    return {line for line, is_good in lines if is_good} - {line for line, is_good in lines if not is_good}


def _empty_cells(table: Table, rows: Sequence[int]) -> dict[int, str]:
    """The column of an empty cell by its row; markers may be missing."""
    needed = {name: values for name, values in table.columns.items() if not MARKER.fullmatch(name)}
    return {i: name for name, values in needed.items() for i in rows if math.isnan(values[i])}


def _all_lines(source: Source, rows: Sized) -> list[int]:
    return source.lines or list(range(1, len(rows) + 1))


def _at(source: Source, line: int) -> str:
    return source.at(line) if isinstance(source, TextSource) else f"line {line}"


def _dead(table: Table) -> None:
    """Say which link-side encoders never change though others do: they are not connected."""
    still = {name: len(set(values)) == 1 for name, values in table.columns.items() if LINK.fullmatch(name)}
    dead = [name for name, is_still in still.items() if is_still]
    if dead and len(dead) < len(still):
        one = len(dead) == 1
        table.warnings.append(
            f"{', '.join(dead)} {'is' if one else 'are'} the same in every row: {'a dead channel' if one else 'dead channels'}"
        )


def _number_poses(table: Table, tolerance_deg: float) -> None:
    """Rows whose joints agree within the tolerance (1 mm counts as 1 deg) share a pose_id, numbered as they come."""
    labels = []
    for name, values in table.columns.items():
        if JOINT.fullmatch(name):
            convert = converter(unit_of(name) or "", "deg") or converter(unit_of(name) or "", "mm")
            assert convert is not None  # joints are angles or lengths
            labels.append(clusters([convert(value) for value in values], tolerance_deg))
    numbers: dict[tuple[int, ...], int] = {}
    table.columns["pose_id"] = [float(numbers.setdefault(key, len(numbers) + 1)) for key in zip(*labels, strict=True)]
    table.notes.append(f"pose_id: {len(numbers)} poses among {len(table)} rows, by equal joints")
