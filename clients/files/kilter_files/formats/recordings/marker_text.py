"""Text recordings of markers: First-Principles-style CSV, and Aurora or Polaris tools with quaternions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.recordings.marker_header import (
    FRAMES,
    RATE,
    MarkerColumns,
    number_above_table,
    understand,
    unit_above,
)
from kilter_files.formats.recordings.polaris_long import long_columns, read_long
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError
from kilter_files.ground.faults import CUT, fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import blocks, count_rows, line_number_of_row
from kilter_files.ground.text_layout import TextLayout, sniff
from kilter_files.ground.units import SIZES
from kilter_files.tables.gaps import unit_quaternions, without_gaps
from kilter_files.tables.recording import Block, Recording

SAMPLE_FRAMES = 2000
GLUED = "If two recordings are concatenated, split the file there."


def read_marker_text(path: Path, rate_hz: float | None = None, allow_cut: bool = False) -> Recording:
    """Read a text recording; ``rate_hz`` overrides what the file says.

    Raises:
        FileError: no markers among its columns, no rate, fewer rows than it states, or a damaged row.

    """
    layout = sniff(path)
    long = long_columns(layout)
    if long is not None:
        return read_long(path, layout, long, rate_hz)
    columns = understand(layout)
    if not columns.xyz:
        named = ", ".join(layout.names[:12])
        remedy = "Points of a tracker or CMM have their own reader (kilter inspect); for others write a column map."
        raise fault(path, f"no marker with x, y and z among its columns ({named})", remedy, line=layout.first_line)
    rows, cut = _rows(path, layout, allow_cut)
    reader = _Reader(path, layout, columns, *_unit(path, layout, columns), rows, 1.0)
    reader.rate_hz = rate_hz or _rate(reader)
    return Recording(
        path,
        "tool-csv" if columns.turns else "marker-csv",
        columns.names,
        reader.rate_hz,
        rows,
        lambda: _blocks(reader),
        tuple(_notes(layout, columns, reader)),
        tuple([f"columns left out: {', '.join(columns.ignored)}"] if columns.ignored else []) + cut,
        reader.unit,
    )


@dataclass
class _Reader:
    path: Path
    layout: TextLayout
    columns: MarkerColumns
    unit: str
    to_mm: float
    rows: int
    rate_hz: float

    def blocks(self) -> Iterator[Floats]:
        return blocks(self.path, self.layout, self.columns.needed_columns, self.rows)


def _unit(path: Path, layout: TextLayout, columns: MarkerColumns) -> tuple[str, float]:
    unit = columns.unit or unit_above(layout) or "mm"
    if unit not in SIZES["length"]:
        what = f"its coordinates are in {unit!r}"
        raise fault(path, what, f"Export all of them in one of {', '.join(SIZES['length'])}.", line=layout.first_line)
    return unit, SIZES["length"][unit] / SIZES["length"]["mm"]


def _rows(path: Path, layout: TextLayout, allow_cut: bool) -> tuple[int, tuple[str, ...]]:
    (rows, cut), stated = count_rows(path, layout), number_above_table(layout, FRAMES)
    lines = rows + (cut is not None)
    if stated is not None and lines < stated and not allow_cut:
        raise fault(path, f"is cut off: it states {stated:.0f} frames, {rows} are there", CUT, frame=rows + 1)
    if stated is not None and lines > stated:
        line = line_number_of_row(path, layout, int(stated))
        raise fault(path, f"has {lines} frames where it states {stated:.0f}", GLUED, line=line)
    short = stated is not None and rows < stated
    said = f"cut off: the {rows} complete frames are used"
    return rows, tuple(text for text in (cut, said if short else None) if text is not None)


def _rate(reader: _Reader) -> float:
    """The rate: what a line above the table says, else the usual step of the time column."""
    stated = number_above_table(reader.layout, RATE)
    if stated is not None and 0 < stated < 1e6:
        return stated
    if reader.columns.clock:
        times: list[Floats] = []
        for table in reader.blocks():
            times.append(_seconds(reader, table[:SAMPLE_FRAMES]))
            break
        steps = np.diff(np.concatenate(times)) if times else np.zeros(0)
        steps = steps[steps > 0]
        if len(steps):
            return float(1.0 / np.median(steps))
    raise fault(
        reader.path, "says neither rate nor time", "Give the rate in Hz (--rate).", line=reader.layout.first_line
    )


def _notes(layout: TextLayout, columns: MarkerColumns, reader: _Reader) -> list[str]:
    delimiter = {"\t": "tab", " ": "blanks"}.get(layout.delimiter, layout.delimiter)
    stated = columns.unit or unit_above(layout)
    return [
        f"{layout.encoding} text, delimiter {delimiter}, decimal {layout.decimal!r}, first frame in line "
        f"{layout.first_line}",
        f"coordinates in {reader.unit}" + ("" if stated else ", which the file does not state"),
        "time from the file" if columns.clock else "time from the frame counter" if columns.counter is not None
        else "time from the rate",
    ]  # fmt: skip


def _seconds(reader: _Reader, table: Floats) -> Floats:
    place = {column: i for i, column in enumerate(reader.columns.needed_columns)}
    return np.asarray(sum(table[:, place[i]] * factor for i, factor in reader.columns.clock), dtype=np.float64)


def _blocks(reader: _Reader) -> Iterator[Block]:
    place = {column: i for i, column in enumerate(reader.columns.needed_columns)}
    xyz = [[place[i] for i in group] for group in reader.columns.xyz]
    turns = [[place[i] for i in group] for group in reader.columns.turns]
    row, start, last = 0, None, -np.inf
    for table in reader.blocks():
        count = _count(reader, table, row)
        _refuse_going_back(reader, count, last, row)
        start = float(count[0]) if start is None else start
        last = float(count[-1])
        _refuse_partial(reader, table, xyz, row)
        points = without_gaps(table[:, xyz] * reader.to_mm)
        turned = _validated_quaternions(reader, table[:, turns], points, row) if turns else None
        rows = np.arange(row, row + len(table)) + reader.layout.first_line
        yield Block((count - start) / (1.0 if reader.columns.clock else reader.rate_hz), points, rows, turned)
        row += len(table)


def _count(reader: _Reader, table: Floats, row: int) -> Floats:
    """What orders the frames: seconds, else the frame counter, else the rows."""
    if reader.columns.clock:
        return _seconds(reader, table)
    if reader.columns.counter is None:
        return np.arange(row, row + len(table), dtype=np.float64)
    counter: Floats = table[:, reader.columns.needed_columns.index(reader.columns.counter)]
    whole = np.isnan(counter) | (counter == np.round(counter))
    if not whole.all():
        raise _row_fault(
            reader, row + int(np.argmin(whole)), "the frame counter is not a whole number: columns moved here"
        )
    return counter


def _refuse_going_back(reader: _Reader, count: Floats, last: float, row: int) -> None:
    what = "time" if reader.columns.clock else "the frame counter"
    if np.isnan(count).any():
        raise _row_fault(reader, row + int(np.argmax(np.isnan(count))), f"{what} is missing: columns moved here")
    back = np.diff(count, prepend=last) < 0 if reader.columns.clock else np.diff(count, prepend=last) <= 0
    if back.any():
        raise _row_fault(reader, row + int(np.argmax(back)), f"{what} goes back. {GLUED[:-1]}")


def _refuse_partial(reader: _Reader, table: Floats, xyz: list[list[int]], row: int) -> None:
    absent = np.isnan(table[:, xyz])
    partial = absent.any(axis=2) & ~absent.all(axis=2)
    if partial.any():
        frame, marker = np.argwhere(partial)[0]
        axis = int(np.argmax(absent[frame, marker]))
        column = reader.layout.names[reader.columns.xyz[marker][axis]]
        what = f"{'xyz'[axis]} of {reader.columns.names[marker]} is blank where its other coordinates are not"
        raise _row_fault(reader, row + int(frame), f"{what}: did the columns move here", column)


def _validated_quaternions(reader: _Reader, raw: Floats, points: Floats, row: int) -> Floats:
    turned, wrong = unit_quaternions(raw, points)
    if wrong.any():
        frame, marker = np.argwhere(wrong)[0]
        column = reader.layout.names[reader.columns.turns[marker][0]]
        what = f"the quaternion of {reader.columns.names[marker]} does not have length 1: did the columns move here"
        raise _row_fault(reader, row + int(frame), what, column)
    return turned


def _row_fault(reader: _Reader, row: int, what: str, column: str | None = None) -> FileError:
    place = {} if column is None else {"column": column}
    line = line_number_of_row(reader.path, reader.layout, row)
    return fault(reader.path, what, "Correct the row, or export again.", line=line, **place)
