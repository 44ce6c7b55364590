"""The tables [join] of a column map: which further files there are, and how their rows are found."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_files.ground.units import SIZES, TIMESTAMP
from kilter_files.maps.columns import Columns, read_columns
from kilter_files.maps.orientation import Orientation, read_orientation
from kilter_files.maps.section import Section
from kilter_files.tables.source import Layout

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
