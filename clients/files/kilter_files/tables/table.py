"""Measurements in contract columns, and their way to the server as bytes.

A joint log: the joints of every row, and what else the controller wrote beside them.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.ground.units import JOINT, SELDOM

CSV_TYPE = "text/csv"
PARQUET_TYPE = "application/vnd.apache.parquet"
JSON_TYPE = "application/json"

WHOLE_NUMBERS = ("pose_id", "row", "session", "dir", "bar_id", "socket_id", "plane_id")


@dataclass
class Table:
    """Rows read from a foreign file: contract columns (NaN = not measured) and the line each row stood on."""

    columns: dict[str, list[float]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def keep(self, index: list[int]) -> None:
        """Keep only the rows of ``index``, in that order."""
        self.columns = {name: [values[i] for i in index] for name, values in self.columns.items()}
        self.lines = [self.lines[i] for i in index]

    def to_csv(self) -> bytes:
        """Write the contract's CSV: every digit of every number, empty cells where nothing was measured."""
        out = io.StringIO(newline="")
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(zip(*(cells(name, values) for name, values in self.columns.items()), strict=True))
        return out.getvalue().encode()


def cells(name: str, values: list[float]) -> list[str]:
    """Return the cells of a column: every digit of every number, an empty one where nothing was measured."""
    whole = name.startswith(WHOLE_NUMBERS)
    return ["" if math.isnan(v) else str(int(v)) if whole and v.is_integer() else repr(v) for v in values]


@dataclass(frozen=True)
class Prepared:
    """What is sent: the bytes, their type, and what was understood of the file they came from.

    ``rows`` and ``lines`` (the line of the file behind each row) are known only of converted files.
    """

    content: bytes
    content_type: str
    columns: tuple[str, ...] = ()
    rows: int | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()

    @cached_property
    def sha256(self) -> str:
        """The content hash by which the server knows these bytes again."""
        return hashlib.sha256(self.content).hexdigest()

    @classmethod
    def from_table(cls, table: Table) -> Prepared:
        """Write a converted table as CSV bytes: the same file gives the same bytes everywhere."""
        return cls(
            table.to_csv(),
            CSV_TYPE,
            tuple(table.columns),
            len(table),
            tuple(table.notes),
            tuple(table.warnings),
            tuple(table.lines),
        )


MOST_RAD = 4.2 * math.pi  # no revolute joint of an arm makes more than two turns either way


@dataclass(frozen=True)
class JointLog:
    """``columns`` by contract name, each (n); ``joints`` are the names q1_..., in order.

    ``begins_ns`` is the clock's time at which ``t_s`` is zero, of a bag. ``calibration_sha256`` is that of the servos'
    zeros, where the log has any: rows of another are those of another arm.
    """

    path: Path
    joints: tuple[str, ...]
    columns: dict[str, Floats]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    calibration_sha256: str | None = None
    begins_ns: int | None = None

    def __len__(self) -> int:
        return len(self.columns[self.joints[0]])

    @property
    def t_s(self) -> Floats | None:
        """The log's own time."""
        return self.columns.get("t_s")

    def q(self) -> Floats:
        """Return the joints (n, joints), in the units of their names."""
        return np.stack([self.columns[name] for name in self.joints], axis=1)

    def q_even(self) -> Floats:
        """Return the joints (n, joints) in deg and mm, for comparing sizes of motions."""
        factor = {"deg": 1.0, "rad": math.degrees(1), "mm": 1.0, "m": 1000.0}
        return np.asarray(self.q() * np.array([factor[name.partition("_")[2]] for name in self.joints]))


def checked_log(path: Path, columns: dict[str, Floats], lines: list[int], rows: str = "line") -> JointLog:
    """Return a joint log of these columns; ``lines`` are the places of its rows, called ``rows``.

    Raises:
        FileError: no joints, an empty cell, time that goes back, degrees called radians.

    """
    numbered = sorted((int(m[1]), name) for name in columns if (m := JOINT.fullmatch(name)))
    if not numbered or [number for number, _ in numbered] != list(range(1, len(numbered) + 1)):
        remedy = "A joint log has q1_deg, q2_deg, ... without a gap; for other names use a column map."
        raise fault(path, f"its joints are {', '.join(name for _, name in numbered) or 'missing'}", remedy)
    for name, values in columns.items():
        if np.isnan(values).any() and not SELDOM.fullmatch(name):
            row = int(np.argmax(np.isnan(values)))
            raise fault(path, "is empty", "Fill it or leave the row out.", **{rows: _line(lines, row)}, column=name)
    _refuse_degrees(path, columns, lines, rows)
    back = np.flatnonzero(np.diff(columns["t_s"]) <= 0) if "t_s" in columns else np.zeros(0, int)
    if len(back):
        what = "time goes back or stops: two logs concatenated"
        raise fault(path, what, "Split the log there.", **{rows: _line(lines, int(back[0]) + 1)}, column="t_s")
    return JointLog(path, tuple(name for _, name in numbered), columns)


def _refuse_degrees(path: Path, columns: dict[str, Floats], lines: list[int], rows: str) -> None:
    for name, values in columns.items():
        if JOINT.fullmatch(name) and name.endswith("_rad") and np.abs(values).max() > MOST_RAD:
            row = int(np.argmax(np.abs(values)))
            what = f"{values[row]:.6g} rad is more than two turns: are these degrees"
            remedy = f"Name the column {name[:-3]}deg." if rows == "line" else "ROS means radians: correct the driver."
            raise fault(path, what, remedy, **{rows: _line(lines, row)}, column=name)


def _line(lines: list[int], row: int) -> int:
    return lines[row] if row < len(lines) else row + 1
