"""The controller's joint log: contract columns (q1_deg ..., t_s, pose_id), a ROS 2 bag, or a program's targets."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kilter_files.formats.joints.bag import is_bag, read_bag
from kilter_files.formats.joints.joint_order import ordered
from kilter_files.formats.programs.targets import dialect_of, read_targets
from kilter_files.formats.tables.source import open_source
from kilter_files.formats.tables.text import Layout, TextSource
from kilter_files.ground.faults import fault
from kilter_files.ground.units import unit_of
from kilter_files.tables.recording import Floats

JOINT = re.compile(r"q([1-9]\d?)_(deg|rad|mm|m)")
MARKER = re.compile(r"m[1-9]\d?[xyz]_(mm|m)")
MOST_RAD = 4.2 * math.pi  # no revolute joint of an arm makes more than two turns either way


@dataclass(frozen=True)
class JointLog:
    """``columns`` by contract name, each (n); ``joints`` are the names q1_..., in order."""

    path: Path
    joints: tuple[str, ...]
    columns: dict[str, Floats]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

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


@dataclass(frozen=True)
class LogHints:
    """What the person says of a log: the topic of a bag, and its joints from the base to the tool.

    ``order`` are joint names; a prismatic joint is ``name:m``. ``likely`` is used when the log has all of them.
    """

    topic: str | None = None
    order: Sequence[str] = ()
    likely: Sequence[str] = ()


def read_joint_log(path: Path, column_map: Path | None = None, hints: LogHints = LogHints()) -> JointLog:
    """Read a joint log: contract columns (CSV, Parquet), a bag, a program's targets, or any table through its map.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    if column_map is not None:
        return _mapped(path, column_map)
    if is_bag(path):
        return _of_bag(path, hints)
    if path.suffix.lower() != ".parquet" and dialect_of(path) is not None:
        return _of_targets(path)
    source = open_source(path, "csv" if path.suffix.lower() == ".log" else None, Layout())
    names = list(getattr(source, "names", []))
    unknown = [name for name in names if unit_of(name) is None]
    if unknown:
        what = "is not a contract column such as q1_deg or t_s"
        raise fault(path, what, "Rename it, or give the log's column map (--joints-map).", line=1, column=unknown[0])
    lines = source.lines if isinstance(source, TextSource) else []
    return _checked(path, {name: np.array(source.numbers(name)) for name in names}, lines)


def _mapped(path: Path, column_map: Path) -> JointLog:
    from kilter_files import prepare

    prepared = prepare(path, column_map=column_map)
    table = np.genfromtxt(io.BytesIO(prepared.content), delimiter=",", names=True, ndmin=1)
    return _checked(path, {name: table[name] for name in table.dtype.names or ()}, list(prepared.lines))


def _of_bag(path: Path, hints: LogHints) -> JointLog:
    plain = [name.removesuffix(":m") for name in hints.order]
    likely = [name.removesuffix(":m") for name in hints.likely]
    found = read_bag(path, hints.topic, plain, likely)
    known = found.names == tuple(likely)
    names = ordered(path, found.names, plain or (likely if known else ()))
    slides = {name.removesuffix(":m") for name in (*hints.order, *hints.likely) if name.endswith(":m")}
    columns = {
        f"q{k}_{'m' if name in slides else 'rad'}": found.positions[:, found.names.index(name)]
        for k, name in enumerate(names, 1)
    }
    log = _checked(path, columns | {"t_s": found.t_s}, list(found.messages), "message")
    note = f"q1 to q{len(names)} are {', '.join(names)}"
    return replace(log, notes=(*found.notes, note), warnings=found.warnings)


def _of_targets(path: Path) -> JointLog:
    found = read_targets(path)
    table = np.array(found.joints_deg)
    log = _checked(path, {f"q{k + 1}_deg": table[:, k] for k in range(table.shape[1])}, found.lines)
    return replace(log, notes=tuple(found.notes), warnings=tuple(found.warnings))


def _checked(path: Path, columns: dict[str, Floats], lines: list[int], rows: str = "line") -> JointLog:
    numbered = sorted((int(m[1]), name) for name in columns if (m := JOINT.fullmatch(name)))
    if not numbered or [number for number, _ in numbered] != list(range(1, len(numbered) + 1)):
        remedy = "A joint log has q1_deg, q2_deg, ... without a gap; for other names use a column map."
        raise fault(path, f"its joints are {', '.join(name for _, name in numbered) or 'missing'}", remedy)
    for name, values in columns.items():
        if np.isnan(values).any() and not MARKER.fullmatch(name):
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
