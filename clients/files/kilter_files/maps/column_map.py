"""A column map, and the further files that it joins: their rows are found by row, by id or by time.

Every key is checked when the map is read, so a misspelt one is refused before any measurement is touched.
"""

from __future__ import annotations

import bisect
import math
import re
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError
from kilter_files.ground.time_stamps import DAY_S, Stamp, continuous_seconds, parse_stamp_column
from kilter_files.ground.units import MATRICES, SIZES, TIMESTAMP, UNKNOWN, column_unit, is_sequence, units_like
from kilter_files.maps.columns import Column, Columns, Section, contract_columns, expand_patterns, read_columns
from kilter_files.tables.source import Layout, Source
from kilter_files.tables.table import Table

QUATERNIONS = ("wxyz", "xyzw")


@dataclass(frozen=True)
class Orientation:
    """Three Euler angles, four quaternion parts, or a matrix of nine by ``order``, that become qw, qx, qy, qz."""

    sources: tuple[str | int, ...]
    order: str
    unit: str = "rad"


def read_orientation(top: Section) -> Orientation | None:
    """Read the table [orientation] of a map or of a join, None where there is none.

    Raises:
        FileError: columns that give no orientation.

    """
    section = top.child_section("orientation")
    if section is None:
        return None
    sources = tuple(section.items("from"))
    euler, quaternion, unit = section.text("euler"), section.text("quaternion"), section.text("unit")
    matrix = section.text("matrix")
    section.finish()
    if UNKNOWN in (euler, quaternion, unit, *sources):
        raise section.error('the draft could not determine: fill in what is "?", or delete the table')
    if matrix is not None and (matrix not in MATRICES or euler or quaternion or unit or len(sources) != 9):
        raise section.error('a rotation matrix is nine columns and matrix = "rows" or "columns", without unit')
    if matrix is not None:
        return Orientation(sources, matrix)
    if quaternion is not None and (quaternion not in QUATERNIONS or euler or unit or len(sources) != 4):
        raise section.error('a quaternion is four columns and quaternion = "wxyz" or "xyzw", without unit')
    if quaternion is not None:
        return Orientation(sources, quaternion)
    if euler is None or not is_sequence(euler) or len(sources) != 3 or unit not in units_like("rad"):
        raise section.error(
            'Euler angles are three columns in the order of rotation, unit = "deg" or "rad", and euler = three letters: '
            '"XYZ" about the moving axes (intrinsic), "xyz" about the fixed ones (extrinsic)'
        )
    return Orientation(sources, euler, unit or "rad")


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


WAYS = ("row", "id", "time")


@dataclass(frozen=True)
class Join:
    """A further file, and how its rows belong to those of the first; ``columns`` None: contract columns as they are."""

    path: str | None
    by: str
    here: str | int | None
    there: str | int | None
    unit: str
    within_s: float
    offset_s: float
    form: str | None
    layout: Layout
    columns: Columns | None
    orientation: Orientation | None
    place: str


def read_join(section: Section, form: str | None, layout: Layout) -> Join:
    """Read a table [join]; ``form`` and ``layout`` are those of [join.file].

    Raises:
        FileError: no way of joining, or one that lacks its columns.

    """
    path, by = section.text("path"), section.text("by")
    here, there, unit = section.column("here"), section.column("there"), section.text("unit")
    within, offset = section.number("within_s"), section.number("offset_s")
    columns = read_columns(section) if section.raw("columns") is not None else None
    orientation = read_orientation(section)
    section.finish()
    if by not in WAYS:
        raise section.error(f"how rows of both files belong together is one of {', '.join(WAYS)}, not {by!r}", "by")
    if by == "row" and (here is not None or there is not None):
        raise section.error("rows are joined in their order: leave 'here' and 'there' out, or set by = \"id\"")
    if by != "row" and here is None:
        raise section.error(
            f"needs 'here', the column of the {by}, and 'there' where the other file calls it otherwise"
        )
    if by != "time" and (unit or within is not None or offset is not None):
        raise section.error("'unit', 'within_s' and 'offset_s' belong to by = \"time\"")
    if by == "time" and (within is None or within <= 0 or unit not in (*SIZES["time"], TIMESTAMP)):
        units = ", ".join((*SIZES["time"], TIMESTAMP))
        raise section.error(f"by time needs within_s, how far apart rows may be, and unit = one of {units}")
    return Join(
        path,
        by,
        here,
        here if there is None else there,
        unit or "s",
        within or 0.0,
        offset or 0.0,
        form,
        layout,
        columns,
        orientation,
        section.place,
    )


# TOML wants quotes around a key with a *; people write q* = { ... } without them
BARE_PATTERN = re.compile(r"^([ \t]*)([A-Za-z]\w*\*\w*)([ \t]*=)", re.MULTILINE)


@dataclass(frozen=True)
class Keep:
    """A condition a row must meet to be taken."""

    column: str | int
    equals: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None


@dataclass(frozen=True)
class ColumnMap:
    """A whole column map."""

    path: Path
    form: str | None
    layout: Layout
    columns: Columns
    orientation: Orientation | None
    repeats_deg: float | None
    drop_missing: bool
    keep: tuple[Keep, ...]
    joins: tuple[Join, ...] = ()
    marker: str | int | None = None  # the column that names the one marker of a row
    note: str = ""  # said instead of a note on every column


def contract_map(source: Source) -> ColumnMap:
    """Return the map of a workbook whose columns are the contract's already.

    Raises:
        FileError: other columns; the remedy is a map of one's own.

    """
    path, odd = source.path, [name for name in source.choices if name and column_unit(name) is None]
    columns = contract_columns(source.choices)
    if odd or not columns:
        said = ", ".join(map(repr, odd[:6])) or "none has a name"
        raise FileError(
            f"{path}: not all of its columns are the contract's: {said}. Write a column map "
            f"(`kilter measure inspect {quote(str(path))} --draft columns.toml`) and give it with --map.",
            file=str(path),
        )
    note = "contract columns of the workbook's first sheet"
    return ColumnMap(path, None, Layout(), columns, None, None, drop_missing=False, keep=(), note=note)


def read_map(path: Path, formats: Collection[str]) -> ColumnMap:
    """Read a column map; ``formats`` are the names that [file] may give.

    Raises:
        FileError: no TOML, an unknown key, a target that is not a contract column, units that do not fit.

    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        top = Section(path, "", tomllib.loads(BARE_PATTERN.sub(r'\1"\2"\3', text)))
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is not UTF-8 text, as TOML is. Save it as UTF-8.", file=str(path)) from error
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise FileError(f"{path}: is not a readable column map: {error}.", file=str(path)) from error
    form, layout = _file(top.child_section("file"), formats)
    rows = top.child_section("rows")
    columns = read_columns(top)
    orientation, repeats = read_orientation(top), _repeats(top, columns)
    drop, keep = _rows(rows) if rows else (False, ())
    joins = tuple(
        read_join(joined, *_file(joined.child_section("file"), formats)) for joined in top.child_sections("join")
    )
    marker = _marker(top)
    top.finish()
    return ColumnMap(path, form, layout, columns, orientation, repeats, drop, keep, joins, marker)


def _file(section: Section | None, formats: Collection[str]) -> tuple[str | None, Layout]:
    if section is None:
        return None, Layout()
    form = section.text("format")
    if form is not None and form not in formats:
        raise section.error(f"must be one of {', '.join(formats)}, not {form!r}", "format")
    decimal, delimiter = section.text("decimal", ".") or "", section.text("delimiter")
    delimiter = (";" if decimal == "," else ",") if delimiter is None else delimiter
    if decimal not in (".", ",") or len(delimiter) != 1 or delimiter == decimal:
        raise section.error("'delimiter' is one character, 'decimal' is \".\" or \",\", and the two differ")
    layout = Layout(
        delimiter,
        decimal,
        section.text("encoding", "utf-8-sig") or "",
        section.count("skip_rows", 0),
        section.flag("header", True),
        section.text("comment", "") or "",
        tuple(item if isinstance(item, str) else float(item) for item in section.items("missing")),
        section.flag("units_row", False),
        section.column("sheet"),
        section.count("rows_per_pose", 1),
    )
    section.finish()
    if layout.sheet is not None and form not in (None, "xlsx"):
        raise section.error('a sheet belongs to a workbook (format = "xlsx")', "sheet")
    if layout.rows_per_pose < 1 or (layout.rows_per_pose > 1 and (layout.header or form not in (None, "csv"))):
        raise section.error("is of a text without a header (header = false), 1 or more", "rows_per_pose")
    return form, layout


def _marker(top: Section) -> str | int | None:
    section = top.child_section("markers")
    if section is None:
        return None
    column = section.column("from")
    section.finish()
    if column is None:
        raise section.error("needs 'from', the column that names the marker of a row", "from")
    return column


def _repeats(top: Section, columns: Columns) -> float | None:
    section = top.child_section("pose_id")
    if section is None:
        return None
    tolerance = section.number("same_joints_within_deg")
    section.finish()
    if tolerance is None or tolerance <= 0:
        raise section.error("needs same_joints_within_deg, for example 0.001", "same_joints_within_deg")
    if any(column.target == "pose_id" for column in columns):
        raise section.error("is given twice: here and under [columns]")
    return tolerance


def _rows(section: Section) -> tuple[bool, tuple[Keep, ...]]:
    drop = section.flag("drop_missing", False)
    keep = tuple(_keep(Section(section.path, f"rows.keep[{i}]", item)) for i, item in enumerate(section.items("keep")))
    section.finish()
    return drop, keep


def _keep(section: Section) -> Keep:
    column, equals = section.column("column"), section.raw("equals")
    minimum, maximum = section.number("min"), section.number("max")
    section.finish()
    if column is None or (equals is None) == (minimum is None and maximum is None):
        raise section.error("needs 'column' and either 'equals' (a value or a list) or 'min' and/or 'max'")
    values = equals if isinstance(equals, list) else [] if equals is None else [equals]
    return Keep(column, tuple(str(value) for value in values), minimum, maximum)
