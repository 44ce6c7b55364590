"""A joint log: the joints of every row, and what else the controller wrote beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.ground.units import JOINT, SELDOM

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
