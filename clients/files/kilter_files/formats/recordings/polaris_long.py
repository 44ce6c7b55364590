"""Long tables of NDI tools: one row per tool and frame, with a quaternion or a rotation matrix."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.recordings.marker_header import unit_above
from kilter_files.formats.tracker_header import canonical_column_name
from kilter_files.ground.arrays import Floats
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.faults import fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import MISSING, count_rows, numbered_lines
from kilter_files.ground.text_layout import TextLayout
from kilter_files.ground.turns import quaternions_from_matrices
from kilter_files.ground.units import SIZES
from kilter_files.tables.gaps import unit_quaternions, without_gaps
from kilter_files.tables.recording import Block, Recording

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
    path: Path, layout: TextLayout, columns: LongColumns, rate_hz: float | None, tools: list[str],
    frames: NDArray[np.int64], cells: list[tuple[int, int, int, list[float]]],
) -> Recording:  # fmt: skip
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
    path: Path, layout: TextLayout, columns: LongColumns, rate_hz: float | None,
    frames: NDArray[np.int64], at: NDArray[np.int64], values: Floats,
) -> tuple[Floats, float]:  # fmt: skip
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
