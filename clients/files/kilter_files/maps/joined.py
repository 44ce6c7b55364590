"""The columns of further files beside those of the first: their rows are found by row, by id or by time."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from pathlib import Path

from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError
from kilter_files.ground.time_stamps import DAY_S, Stamp, continuous_seconds, parse_stamp_column
from kilter_files.ground.units import SIZES, TIMESTAMP
from kilter_files.maps.column_map import ColumnMap
from kilter_files.maps.columns import Column, contract_columns, expand_patterns
from kilter_files.maps.join import Join
from kilter_files.tables.source import Source
from kilter_files.tables.table import Table

SHOWN = 5


def joined_columns(join: Join, there: Source, map_path: Path) -> tuple[Column, ...]:
    """Return the columns that a further file gives: those of its [join.columns], else those named as the contract's.

    Raises:
        FileError: none at all.

    """
    found = contract_columns(there.choices) if join.columns is None else join.columns
    if not found and join.orientation is None:
        raise _fault_of_columns(join, map_path, f"{there.path} gives no contract column: add [join.columns]")
    return expand_patterns(found, there.choices, map_path, there.path)


def add_joined(table: Table, here: Source, join: Join, there: Source, theirs: Table, column_map: ColumnMap) -> None:
    """Add the columns ``theirs`` of a further file to ``table``, row for row; NaN where a row has no partner.

    Raises:
        FileError: a column that stands already, or rows without a partner that are not to be dropped.

    """
    twice = sorted(set(theirs.columns) & set(table.columns))
    if twice:
        what = f"{twice[0]} comes from {there.path.name} and from a file before it"
        raise _fault_of_columns(join, column_map.path, what)
    rows = partners(join, here, there, (len(table), len(theirs)))
    if not column_map.drop_missing:
        refuse_alone(join, rows, table.lines, (here.path, there.path))
    table.columns |= {
        name: [math.nan if row is None else values[row] for row in rows] for name, values in theirs.columns.items()
    }
    table.notes += [f"{note}, of {there.path.name} by {join.by}" for note in theirs.notes]
    idle = len(theirs) - len({row for row in rows if row is not None})
    table.warnings += [f"{idle} rows of {there.path.name} have no partner and are left out"] if idle else []


def _fault_of_columns(join: Join, map_path: Path, what: str) -> FileError:
    return FileError(f"{map_path}, {join.place}: {what}.", file=str(map_path), key=f"{join.place}.columns")


def further_files(path: Path, joins: Sequence[Join], map_path: Path, named: Path | None) -> list[Path]:
    """Return the file of each [join] of a map: that of the first as named, else the map's, beside the file or the map.

    Raises:
        FileError: a file is named for a map without [join], or there is none for a map with one.

    """
    if named is not None and not joins:
        raise FileError(
            f"{map_path}: does not say how rows of {named} belong to those of {path}. Add a table [join], for example "
            'by = "row".',
            file=str(map_path),
        )
    left = joins if named is None else joins[1:]
    return [
        *([] if named is None else [named]),
        *(_find_join_file(join, path, map_path, join is joins[0]) for join in left),
    ]


def _find_join_file(join: Join, path: Path, map_path: Path, is_first: bool) -> Path:
    remedy = "or name it with --joints" if is_first else "as --joints names the first"
    place = f"{join.place}.path"
    if join.path is None:
        what = f"{map_path}, {join.place}: names no second file. Give 'path', {remedy}."
        raise FileError(what, file=str(map_path), key=place)
    places = [folder / join.path for folder in (path.parent, map_path.parent)]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        what = f"{map_path}, {place}: there is no file {places[0]}. Correct 'path', {remedy}."
        raise FileError(what, file=str(map_path), key=place)
    return found


def partners(join: Join, here: Source, there: Source, rows: tuple[int, int]) -> list[int | None]:
    """Return for each row of the first file its row in the second, from 0; None where there is none.

    Raises:
        FileError: different numbers of rows, an id that stands twice with the second file, a time that is none.

    """
    if join.by == "row":
        if rows[0] != rows[1]:
            raise FileError(
                f"{here.path} has {rows[0]} rows and {there.path} {rows[1]}: joined by row they must be as many. Join them by "
                '"id" or "time", or delete the rows that have no partner.',
                file=str(there.path),
            )
        return list(range(rows[0]))
    assert join.here is not None
    assert join.there is not None
    if join.by == "id":
        return _by_id(here.texts(join.here), there.texts(join.there), there.path, there.lines, join.there)
    ours, theirs = _both_times(join, here, there)
    return _by_time(ours, theirs, join)


def refuse_alone(join: Join, found: Sequence[int | None], lines: Sequence[int], files: tuple[Path, Path]) -> None:
    """Refuse rows without a partner, all at once.

    Raises:
        FileError: there are such rows.

    """
    alone = [line for line, row in zip(lines, found, strict=True) if row is None]
    if not alone:
        return
    near = f" within {join.within_s:g} s" if join.by == "time" else ""
    shown = ", ".join(map(str, alone[:SHOWN])) + (f" and {len(alone) - SHOWN} more" if len(alone) > SHOWN else "")
    remedy = "widen 'within_s', state 'offset_s'" if join.by == "time" else f"correct {join.here!r}"
    raise FileError(
        f"{files[0]}: {len(alone)} of {len(found)} rows have no row of {files[1]} with their {join.by}{near} (line {shown}). "
        f"Under [{join.place}] {remedy}, or set drop_missing = true under [rows] to leave them out.",
        file=str(files[0]),
        line=alone[0],
        lines=alone[:1000],
    )


def _by_id(ours: list[str], theirs: list[str], file: Path, lines: list[int], column: str | int) -> list[int | None]:
    place: dict[str, int] = {}
    for row, text in enumerate(theirs):
        key = _id(text)
        if key in place:
            first, second = (lines[k] if k < len(lines) else k + 1 for k in (place[key], row))
            raise FileError(
                f"{file}, line {second}, column {column!r}: the id {text!r} stands in line {first} already. Give every row "
                'an id of its own, or join by "row" or "time".',
                file=str(file),
                line=second,
                column=column,
            )
        if key:
            place[key] = row
    return [place.get(_id(text)) for text in ours]


def _id(text: str) -> str:
    """One spelling for numbers: 7, 7.0 and 007 are one id."""
    value = parse_number(text)
    return text if value is None else "" if math.isnan(value) else repr(value)


def _by_time(ours: list[float], theirs: list[float], join: Join) -> list[int | None]:
    order = sorted((t, row) for row, t in enumerate(theirs) if not math.isnan(t))
    times = [t for t, _ in order]
    out: list[int | None] = []
    for t in ours:
        if math.isnan(t):
            out.append(None)
            continue
        at = bisect.bisect_left(times, t + join.offset_s)
        near = min(
            range(max(0, at - 1), min(len(times), at + 1)),
            key=lambda k: abs(times[k] - t - join.offset_s),
            default=None,
        )
        close = near is not None and abs(times[near] - t - join.offset_s) <= join.within_s
        out.append(order[near][1] if near is not None and close else None)
    return out


def _both_times(join: Join, here: Source, there: Source) -> tuple[list[float], list[float]]:
    assert join.here is not None
    assert join.there is not None
    if join.unit != TIMESTAMP:
        size = SIZES["time"][join.unit]
        return [size * t for t in here.numbers(join.here)], [size * t for t in there.numbers(join.there)]
    ours, theirs = (
        parse_stamp_column(s.texts(c), s.lines, s.path, c) for s, c in ((here, join.here), (there, join.there))
    )
    if len({stamp.dated for stamp in (*ours, *theirs)}) > 1:  # one has dates, the other clocks only
        ours, theirs = ([Stamp(stamp.seconds % DAY_S, False) for stamp in found] for found in (ours, theirs))
    return continuous_seconds(ours), continuous_seconds(theirs)
