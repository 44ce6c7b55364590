"""Text exports of markers or tools, one frame in a line."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.marker_header import (
    FRAMES,
    RATE,
    MarkerColumns,
    canonical_column_name,
    is_recording,
    number_above_table,
    understand,
    unit_above,
)
from kilter_files.formats.reader import NO_HINTS, Document, Head, Hints, RecordingReader
from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import CUT, FileError, fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import MISSING, blocks, count_rows, line_number_of_row, numbered_lines
from kilter_files.ground.text_layout import TextLayout, sniff
from kilter_files.ground.units import SIZES, quaternions_from_matrices
from kilter_files.tables.recording import Block, Recording, in_stated_unit, unit_quaternions, without_gaps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kilter_files.tables.recording import Recording

TOOL = re.compile(r"tool(?:id|name|handle|number|no)?|handle|port(?:handle|no|number)?|rom|sensor(?:id)?")
FRAME = re.compile(r"frame(?:no|number|nr|index)?")
TIME = re.compile(r"time(?:stamp)?(?:s|ms)?|t")
TURNS = {"q0": "qw", "qo": "qw", "qw": "qw", "qx": "qx", "qy": "qy", "qz": "qz"}
MOST_ROWS = 5_000_000
NOT_SEEN = {"missing", "disabled", "occluded", "bad"}


@dataclass(frozen=True)
class LongColumns:
    """Which column is the tool, the frame, the time, the position, and the quaternion (4) or the matrix (9)."""

    tool: int
    frame: int
    time: int | None
    xyz: tuple[int, ...]
    turns: tuple[int, ...]


def long_columns(layout: TextLayout) -> LongColumns | None:
    """Return the columns of a long table, None when it is none."""
    names = [canonical_column_name(name) for name in layout.names]

    def first_matching_column(pattern: re.Pattern[str]) -> int | None:
        return next((i for i, name in enumerate(names) if pattern.fullmatch(name)), None)

    tool, frame = first_matching_column(TOOL), first_matching_column(FRAME)
    place = {
        name.removeprefix("t") if name in ("tx", "ty", "tz") else TURNS.get(name, name): i
        for i, name in enumerate(names)
    }
    matrix = [place.get(f"r{i}{j}") for i in range(3) for j in range(3)]
    quaternion = [place.get(f"q{part}") for part in "wxyz"]
    xyz = [place.get(axis) for axis in "xyz"]
    turns = quaternion if None not in quaternion else matrix
    if tool is None or frame is None or None in xyz or None in turns:
        return None
    return LongColumns(
        tool,
        frame,
        first_matching_column(TIME),
        tuple(i for i in xyz if i is not None),
        tuple(i for i in turns if i is not None),
    )


def read_long(path: Path, layout: TextLayout, columns: LongColumns, rate_hz: float | None) -> Recording:
    """Read a long table as frames of tools.

    Raises:
        FileError: a damaged row, a tool twice in a frame, frames that go back, no rate.

    """
    tools: dict[str, int] = {}
    frames: list[int] = []
    cells: list[tuple[int, int, int, list[float]]] = []  # frame's place, tool, line, numbers
    there: set[tuple[int, int]] = set()
    rows, cut = count_rows(path, layout)
    for row, (line, text) in enumerate(itertools.islice(numbered_lines(path, layout), rows)):
        if row == MOST_ROWS:
            raise fault(path, f"has more than {MOST_ROWS} rows", "Split it.", line=line)
        parts = layout.split(text)
        if len(parts) != layout.width:
            what = f"{len(parts)} cells where the first row has {layout.width}"
            raise fault(path, what, "Correct the row; if another table begins here, split the file.", line=line)
        number = _number(path, layout, parts, columns.frame, line)
        if not float(number).is_integer():
            raise fault(path, "the frame is not a whole number", "Did the columns move here?", line=line)
        if not frames or int(number) > frames[-1]:
            frames.append(int(number))
        elif int(number) < frames[-1]:
            raise fault(path, "the frame goes back: two recordings concatenated", "Split the file there.", line=line)
        tool = tools.setdefault(parts[columns.tool], len(tools))
        if (len(frames), tool) in there:
            raise fault(path, f"tool {parts[columns.tool]!r} is twice in frame {int(number)}", "Split it.", line=line)
        there.add((len(frames), tool))
        wanted = (*columns.xyz, *columns.turns, *(() if columns.time is None else (columns.time,)))
        cells.append((len(frames) - 1, tool, line, [_number(path, layout, parts, i, line) for i in wanted]))
    found = _recording(path, layout, columns, rate_hz, list(tools), np.array(frames), cells)
    return found if cut is None else replace(found, warnings=(*found.warnings, cut))


def _recording(
    path: Path,
    layout: TextLayout,
    columns: LongColumns,
    rate_hz: float | None,
    tools: list[str],
    frames: NDArray[np.int64],
    cells: list[tuple[int, int, int, list[float]]],
) -> Recording:
    at, tool, line = (np.array([cell[k] for cell in cells]) for k in range(3))
    values = np.array([cell[3] for cell in cells])
    unit = layout.units[columns.xyz[0]] or unit_above(layout) or "mm"
    if unit not in SIZES["length"]:
        raise fault(path, f"its positions are in {unit}", "Export them in mm.", line=layout.first_line)
    points = np.full((len(frames), len(tools), 3), np.nan)
    points[at, tool] = values[:, :3] * (SIZES["length"][unit] / SIZES["length"]["mm"])
    points = without_gaps(points)
    turned = np.full((len(frames), len(tools), 4), np.nan)
    turned[at, tool] = _turns(path, values[:, 3 : 3 + len(columns.turns)], points[at, tool], line)
    turned, wrong = unit_quaternions(turned, points)
    if wrong.any():
        frame, k = np.argwhere(wrong)[0]
        where = int(line[np.flatnonzero((at == frame) & (tool == k))[0]])
        raise fault(
            path, f"the quaternion of {tools[k]} does not have length 1", "Did the columns move here?", line=where
        )
    rows = np.zeros(len(frames), np.int64)
    rows[at[::-1]] = line[::-1]
    t, rate = _time(path, layout, columns, rate_hz, frames, at, values)

    def blocks() -> Iterator[Block]:
        yield Block(t, points.copy(), rows, turned.copy())

    by = "matrix" if len(columns.turns) == 9 else "quaternion"
    note = f"one row per tool and frame; positions in {unit}, orientation by {by}"
    names = tuple(f"tool {name}" for name in tools)
    return Recording(path, "tool-long-csv", names, rate, len(frames), blocks, (note,), unit=unit)


def _turns(path: Path, values: Floats, points: Floats, line: Floats) -> Floats:
    """Quaternions (n, 4) of quaternions or of matrices (n, 9)."""
    if values.shape[1] == 4:
        return values
    matrices = values.reshape(-1, 3, 3)
    off = np.abs(np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)).max(axis=(1, 2))
    seen = ~np.isnan(points[:, 0])
    with np.errstate(invalid="ignore"):
        wrong = seen & ~((off < 0.02) & (np.linalg.det(matrices) > 0))
    if wrong.any():
        where = int(line[int(np.argmax(wrong))])
        raise fault(path, "R00 to R22 are not a rotation", "Did the columns move here?", line=where)
    return quaternions_from_matrices(np.where(seen[:, None, None], matrices, np.nan))


def _time(
    path: Path,
    layout: TextLayout,
    columns: LongColumns,
    rate_hz: float | None,
    frames: NDArray[np.int64],
    at: NDArray[np.int64],
    values: Floats,
) -> tuple[Floats, float]:
    if rate_hz is not None:
        return (frames - frames[0]) / rate_hz, rate_hz
    if columns.time is None:
        raise fault(path, "says neither rate nor time", "Give the rate in Hz (--rate).", line=layout.first_line)
    t = np.zeros(len(frames))
    named = canonical_column_name(layout.names[columns.time])
    unit = layout.units[columns.time] or ("ms" if named.endswith("ms") and named != "ms" else "s")
    t[at[::-1]] = values[::-1, -1] * SIZES["time"].get(unit, 1.0)
    step = np.diff(t)
    if (step < 0).any() or len(t) < 2 or not t[-1] > t[0]:
        raise fault(path, "its time goes back or stops", "Give the rate in Hz (--rate).", line=layout.first_line)
    return t - t[0], float(1.0 / np.median(step[step > 0]))


def _number(path: Path, layout: TextLayout, cells: list[str], i: int, line: int) -> float:
    text = cells[i]
    value = float("nan") if text in MISSING or text.lower() in NOT_SEEN else parse_number(text, layout.decimal)
    if value is None:
        what = f"{text[:40]!r} is not a number with decimal {layout.decimal!r}"
        raise fault(path, what, "Correct the cell; did the columns move here?", line=line, column=layout.names[i])
    return value


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
        remedy = (
            "Points of a tracker or CMM have their own reader (kilter measure inspect); for others write a column map."
        )
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
        "time from the file"
        if columns.clock
        else "time from the frame counter"
        if columns.counter is not None
        else "time from the rate",
    ]


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


class MarkerText(RecordingReader):
    """Frames of markers, and not one point in a row that somebody chose to measure."""

    name = "text"
    title = "text export of markers or tools, one frame in a line"
    endings = (".csv", ".tsv", ".txt")

    def recognises(self, head: Head) -> bool:
        """A long table of tools, or coordinates with a counter, a rate or a clock."""
        layout = head.layout
        return layout is not None and (long_columns(layout) is not None or is_recording(layout, head.hints.rate_hz))

    def describe(self, head: Head) -> Document:
        """Frames, and gaps and noise of each marker, and how the text is laid out."""
        assert head.layout is not None  # it was recognised
        return super().describe(head) | {"layout": head.layout.to_document()}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Recording:
        """Read the frames."""
        return in_stated_unit(read_marker_text(path, hints.rate_hz, hints.allow_cut), hints.unit)


READER = MarkerText()
