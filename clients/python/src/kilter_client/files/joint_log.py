"""The controller's joint log: contract columns (q1_deg ..., optional t_s, pose_id) as arrays."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kilter_client.files.faults import fault
from kilter_client.files.recording import Floats
from kilter_client.files.source import open_source
from kilter_client.files.source_text import Layout, TextSource
from kilter_client.files.units import unit_of

JOINT = re.compile(r"q([1-9]\d?)_(deg|rad|mm|m)")
MOST_RAD = 4.2 * math.pi  # no revolute joint of an arm turns more than two times either way


@dataclass(frozen=True)
class JointLog:
    """``columns`` by contract name, each (n); ``joints`` are the names q1_..., in order."""

    path: Path
    joints: tuple[str, ...]
    columns: dict[str, Floats]

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


def read_joint_log(path: Path, column_map: Path | None = None) -> JointLog:
    """Read a joint log: a CSV or Parquet file of contract columns, or any other through its column map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    from kilter_client.files import prepare

    if column_map is not None:
        prepared = prepare(path, column_map=column_map)
        table = np.genfromtxt(io.BytesIO(prepared.content), delimiter=",", names=True, ndmin=1)
        return _checked(path, {name: table[name] for name in table.dtype.names or ()}, list(prepared.lines))
    source = open_source(path, None, Layout())
    names = list(getattr(source, "names", []))
    unknown = [name for name in names if unit_of(name) is None]
    if unknown:
        what = "is no contract column such as q1_deg or t_s"
        raise fault(path, what, "Rename it, or give the log's column map (--joints-map).", line=1, column=unknown[0])
    lines = source.lines if isinstance(source, TextSource) else []
    return _checked(path, {name: np.array(source.numbers(name)) for name in names}, lines)


def _checked(path: Path, columns: dict[str, Floats], lines: list[int]) -> JointLog:
    numbered = sorted((int(m[1]), name) for name in columns if (m := JOINT.fullmatch(name)))
    if not numbered or [number for number, _ in numbered] != list(range(1, len(numbered) + 1)):
        remedy = "A joint log has q1_deg, q2_deg, ... without a gap; other names come in with a column map."
        raise fault(path, f"its joints are {', '.join(name for _, name in numbered) or 'missing'}", remedy)
    for name, values in columns.items():
        if np.isnan(values).any():
            row = int(np.argmax(np.isnan(values)))
            raise fault(path, "is empty", "Fill it or leave the row out.", line=_line(lines, row), column=name)
    _refuse_degrees(path, columns, lines)
    back = np.flatnonzero(np.diff(columns["t_s"]) <= 0) if "t_s" in columns else np.zeros(0, int)
    if len(back):
        what = "time goes back or stands still: two logs glued together"
        raise fault(path, what, "Split the log there.", line=_line(lines, int(back[0]) + 1), column="t_s")
    return JointLog(path, tuple(name for _, name in numbered), columns)


def _refuse_degrees(path: Path, columns: dict[str, Floats], lines: list[int]) -> None:
    for name, values in columns.items():
        if JOINT.fullmatch(name) and name.endswith("_rad") and np.abs(values).max() > MOST_RAD:
            row = int(np.argmax(np.abs(values)))
            what = f"{values[row]:.6g} rad is more than two turns: are these degrees"
            raise fault(path, what, f"Name the column {name[:-3]}deg.", line=_line(lines, row), column=name)


def _line(lines: list[int], row: int) -> int:
    return lines[row] if row < len(lines) else row + 1
