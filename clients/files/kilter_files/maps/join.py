"""The tables [join] of a column map: the rows of further files, found by row, by id or by time."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError
from kilter_files.ground.time_stamps import DAY_S, Stamp, seconds_of, stamps_of
from kilter_files.ground.units import SIZES, TIMESTAMP
from kilter_files.maps.columns import Columns, read_columns
from kilter_files.maps.orientation import Orientation, read_orientation
from kilter_files.maps.section import Section
from kilter_files.tables.source import Layout, Source

WAYS = ("row", "id", "time")
SHOWN = 5


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
    return Join(path, by, here, here if there is None else there, unit or "s", within or 0.0, offset or 0.0, form, layout,
                columns, orientation, section.place)  # fmt: skip


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
    ours, theirs = (stamps_of(s.texts(c), s.lines, s.path, c) for s, c in ((here, join.here), (there, join.there)))
    if len({stamp.dated for stamp in (*ours, *theirs)}) > 1:  # one has dates, the other clocks only
        ours, theirs = ([Stamp(stamp.seconds % DAY_S, False) for stamp in found] for found in (ours, theirs))
    return seconds_of(ours), seconds_of(theirs)
