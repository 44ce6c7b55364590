"""The controller's joint log: contract columns (q1_deg ..., t_s, pose_id), a ROS 2 bag, or a program's targets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from kilter_files.formats.joints.bag import read_bag
from kilter_files.formats.joints.lerobot.log import log_of_dataset
from kilter_files.formats.programs.targets import read_targets
from kilter_files.formats.reader import NO_LOG_HINTS, LogHints
from kilter_files.formats.registry import has_format, open_source
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.ground.names import did_you_mean
from kilter_files.ground.units import NAMES, column_unit
from kilter_files.tables.joint_log import JointLog, checked_log
from kilter_files.tables.source import Layout
from kilter_files.tables.text_source import TextSource

NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
# Universal Robots' joints, which drivers publish by the alphabet: elbow first
KNOWN = (
    ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)


def read_joint_log(path: Path, hints: LogHints = NO_LOG_HINTS) -> JointLog:
    """Read a joint log: contract columns (CSV, Parquet), a bag, a LeRobot data set, or a program's targets.

    Raises:
        FileError: no joints, an unknown column, an empty cell, time that goes back, degrees called radians.

    """
    if has_format(path, "bag"):
        return log_of_bag(path, hints)
    if has_format(path, "lerobot"):
        return log_of_dataset(path, hints)
    if path.suffix.lower() != ".parquet" and has_format(path, "program"):
        return log_of_targets(path)
    source = open_source(path, "csv" if path.suffix.lower() == ".log" else None, Layout())
    names = [name for name in getattr(source, "names", []) if name not in NAMES]
    unknown = [name for name in names if column_unit(name) is None]
    if unknown:
        what = "is not a contract column such as q1_deg or t_s"
        raise fault(path, what, "Rename it, or give the log's column map (--joints-map).", line=1, column=unknown[0])
    lines = source.lines if isinstance(source, TextSource) else []
    return checked_log(path, {name: np.array(source.numbers(name)) for name in names}, lines)


def log_of_bag(path: Path, hints: LogHints) -> JointLog:
    """Read the joints of a topic, from the base to the tool.

    Raises:
        FileError: no bag, a damaged one, several topics, or names that do not tell the order.

    """
    plain = [name.removesuffix(":m") for name in hints.order]
    likely = [name.removesuffix(":m") for name in hints.likely]
    found = read_bag(path, hints.topic, plain, likely)
    known = found.names == tuple(likely)
    names = joints_in_arm_order(path, found.names, plain or (likely if known else ()))
    slides = {name.removesuffix(":m") for name in (*hints.order, *hints.likely) if name.endswith(":m")}
    columns = {
        f"q{k}_{'m' if name in slides else 'rad'}": found.positions[:, found.names.index(name)]
        for k, name in enumerate(names, 1)
    }
    log = checked_log(path, columns | {"t_s": found.t_s}, list(found.messages), "message")
    note = f"q1 to q{len(names)} are {', '.join(names)}"
    return replace(log, notes=(*found.notes, note), warnings=found.warnings, begins_ns=found.begins_ns)


def log_of_targets(path: Path) -> JointLog:
    """Read the joint targets of a program.

    Raises:
        FileError: no targets, or damaged ones.

    """
    found = read_targets(path)
    table = np.array(found.joints_deg)
    log = checked_log(path, {f"q{k + 1}_deg": table[:, k] for k in range(table.shape[1])}, found.lines)
    return replace(log, notes=tuple(found.notes), warnings=tuple(found.warnings))


def joints_in_arm_order(path: Path, names: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Return ``names`` from the first joint to the last: as ``wanted``, by their numbers, or as known of their maker.

    Raises:
        FileError: a wanted joint is not there, or nothing says the order.

    """
    if wanted:
        for name in wanted:
            if name not in names:
                remedy = f"The log has {', '.join(names)}."
                raise fault(path, f"has no joint {name!r}{did_you_mean(name, names)}", remedy)
        return list(wanted)
    found = by_name(names)
    if found is None:
        what = f"nothing says which of its joints is the first ({', '.join(names)})"
        raise fault(path, what, "Name the arm's joints from the base to the tool (--joint-order a,b,c).")
    return found


def by_name(names: Sequence[str]) -> list[str] | None:
    """Return the order that the names themselves tell, None when they tell none."""
    parts = [NUMBERED.fullmatch(name) for name in names]
    alike = {(m[1], m[3]) for m in parts if m}
    numbers = [int(m[2]) for m in parts if m]
    if len(alike) == 1 and len(set(numbers)) == len(names):
        return [name for _, name in sorted(zip(numbers, names, strict=True))]
    for known in KNOWN:
        prefix = next((name.removesuffix(known[0]) for name in names if name.endswith(known[0])), None)
        if prefix is not None and set(names) == {prefix + name for name in known}:
            return [prefix + name for name in known]
    return [names[0]] if len(names) == 1 else None
