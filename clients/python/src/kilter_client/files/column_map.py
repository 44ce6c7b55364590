"""The column map: a TOML file that says which columns of a lab's file are which contract columns.

Every key is checked when the map is read, so a misspelt one is refused before any measurement is touched.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from kilter_client.errors import FileError
from kilter_client.files.orientation import is_sequence
from kilter_client.files.section import Section
from kilter_client.files.source import FORMATS
from kilter_client.files.source_text import Layout
from kilter_client.files.units import converter, unit_of, units_like

QUATERNIONS = ("wxyz", "xyzw")


@dataclass(frozen=True)
class Column:
    """One contract column: ``scale * number + offset`` in the source's unit, then converted; or a constant.

    ``still_below`` makes a speed a direction: its sign, and the one before where the speed is not above it.
    """

    target: str
    source: str | int | None
    unit: str
    scale: float = 1.0
    offset: float = 0.0
    value: float | None = None
    still_below: float | None = None


@dataclass(frozen=True)
class Orientation:
    """Three Euler angles, or four quaternion parts, that become qw, qx, qy, qz."""

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
    columns: tuple[Column, ...]
    orientation: Orientation | None
    repeats_deg: float | None
    drop_missing: bool
    keep: tuple[Keep, ...]


def read_map(path: Path) -> ColumnMap:
    """Read a column map.

    Raises:
        FileError: no TOML, an unknown key, a target that is no contract column, units that do not fit.

    """
    try:
        top = Section(path, "", tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(f"{path}: is no readable column map: {error}.", file=str(path)) from error
    form, layout = _file(top)
    rows = top.part("rows")
    columns = _columns(top)
    found = ColumnMap(
        path, form, layout, columns, _orientation(top), _repeats(top, columns), *(_rows(rows) if rows else (False, ()))
    )
    top.finish()
    return found


def _file(top: Section) -> tuple[str | None, Layout]:
    section = top.part("file")
    if section is None:
        return None, Layout()
    form = section.text("format")
    if form is not None and form not in FORMATS:
        raise section.error(f"must be one of {', '.join(FORMATS)}, not {form!r}", "format")
    decimal = section.text("decimal", ".") or ""
    delimiter = section.text("delimiter", ",") or ""
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
    )
    section.finish()
    return form, layout


def _columns(top: Section) -> tuple[Column, ...]:
    section = top.part("columns")
    if section is None or not section.names():
        raise top.error('needs a table [columns] such as q1_deg = { from = "joint 1", unit = "rad" }')
    return tuple(_column(section, target) for target in section.names())


def _column(columns: Section, target: str) -> Column:
    wanted = unit_of(target)
    if wanted is None:
        raise columns.error(
            "is no contract column; those are q1_deg or _rad, x_mm y_mm z_mm, qw qx qy qz, m1x_mm, link1_deg, t_s, "
            "tau1_nm, dir1, payload_kg, fx_n, mx_nm, temperature_c, session, pose_id, sx_mm, tipx_mm, socket_id, plane_id, "
            "bar_id, bar_mm, each with its unit in the name",
            target,
        )
    section = columns.part(target)
    assert section is not None
    source, value = section.column("from"), section.number("value")
    unit, scale, offset = section.text("unit"), section.number("scale"), section.number("offset")
    sign, still = section.number("sign"), section.number("still_below")
    section.finish()
    if (source is None) == (value is None):
        raise section.error("needs either 'from' (a column of the file) or 'value' (a constant)")
    if value is not None and (unit or scale or offset or sign):
        raise section.error(f"a constant is already in the target's unit: give 'value' alone, in {wanted or '1'}")
    if sign not in (None, 1.0, -1.0) or scale == 0:
        raise section.error("'sign' is 1 or -1, 'scale' is not 0")
    if still is not None and (not target.startswith("dir") or source is None or still < 0):
        raise section.error(
            "'still_below' makes a direction of a speed: for dir1 with 'from', 0 or more", "still_below"
        )
    _check_unit(section, target, wanted, unit, value)
    return Column(target, source, unit or wanted, (scale or 1.0) * (sign or 1.0), offset or 0.0, value, still)


def _check_unit(section: Section, target: str, wanted: str, unit: str | None, value: float | None) -> None:
    if not wanted and unit:
        raise section.error(f"{target} is a plain number and takes no unit", "unit")
    if not wanted or value is not None:
        return
    choices = ", ".join(units_like(wanted))
    if unit is None:
        raise section.error(f"needs the unit the file has it in: unit = one of {choices}")
    if converter(unit, wanted) is None:
        raise section.error(f"{unit!r} cannot become {wanted!r}; use one of {choices}", "unit")


def _orientation(top: Section) -> Orientation | None:
    section = top.part("orientation")
    if section is None:
        return None
    sources = tuple(section.items("from"))
    euler, quaternion, unit = section.text("euler"), section.text("quaternion"), section.text("unit")
    section.finish()
    if quaternion is not None and (quaternion not in QUATERNIONS or euler or unit or len(sources) != 4):
        raise section.error('a quaternion is four columns and quaternion = "wxyz" or "xyzw", without unit')
    if quaternion is not None:
        return Orientation(sources, quaternion)
    if euler is None or not is_sequence(euler) or len(sources) != 3 or unit not in units_like("rad"):
        raise section.error(
            'Euler angles are three columns in turning order, unit = "deg" or "rad", and euler = three letters: '
            '"XYZ" about the moving axes (intrinsic), "xyz" about the fixed ones (extrinsic)'
        )
    return Orientation(sources, euler, unit or "rad")


def _repeats(top: Section, columns: tuple[Column, ...]) -> float | None:
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
