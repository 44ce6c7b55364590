"""The column map: a TOML file that says which columns of a lab's file are which contract columns.

Every key is checked when the map is read, so a misspelt one is refused before any measurement is touched.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from kilter_files.ground.errors import FileError
from kilter_files.ground.units import column_unit
from kilter_files.maps.columns import Columns, contract_columns, read_columns
from kilter_files.maps.join import Join, read_join
from kilter_files.maps.orientation import Orientation, read_orientation
from kilter_files.maps.section import Section
from kilter_files.tables.source import Layout, Source

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
