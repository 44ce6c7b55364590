"""The column map: a TOML file that says which columns of a lab's file are which contract columns.

Every key is checked when the map is read, so a misspelt one is refused before any measurement is touched.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.errors import FileError
from kilter_files.ground.orientation import MATRICES, is_sequence
from kilter_files.ground.units import UNKNOWN, units_like
from kilter_files.maps.columns import Columns, read_columns
from kilter_files.maps.join import Join, read_join
from kilter_files.maps.section import Section
from kilter_files.tables.source import Layout

# TOML wants quotes around a key with a *; people write q* = { ... } without them
BARE_PATTERN = re.compile(r"^([ \t]*)([A-Za-z]\w*\*\w*)([ \t]*=)", re.MULTILINE)
QUATERNIONS = ("wxyz", "xyzw")


@dataclass(frozen=True)
class Orientation:
    """Three Euler angles, four quaternion parts, or a matrix of nine by ``order``, that become qw, qx, qy, qz."""

    sources: tuple[str | int, ...]
    order: str
    unit: str = "rad"


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
    join: Join | None = None


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
    form, layout = _file(top.part("file"), formats)
    rows = top.part("rows")
    columns = read_columns(top)
    orientation, repeats = _orientation(top), _repeats(top, columns)
    drop, keep = _rows(rows) if rows else (False, ())
    joined = top.part("join")
    join = None if joined is None else read_join(joined, *_file(joined.part("file"), formats))
    top.finish()
    return ColumnMap(path, form, layout, columns, orientation, repeats, drop, keep, join)


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
    )
    section.finish()
    if layout.sheet is not None and form not in (None, "xlsx"):
        raise section.error('a sheet belongs to a workbook (format = "xlsx")', "sheet")
    return form, layout


def _orientation(top: Section) -> Orientation | None:
    section = top.part("orientation")
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


def _repeats(top: Section, columns: Columns) -> float | None:
    section = top.part("pose_id")
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
