"""The controller's joint log: contract columns (q1_deg ..., t_s, pose_id), a ROS 2 bag, or a program's targets.

How a joint log is read: a bag's topics and joints, a program's targets.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from kilter_files.formats.joints.bag import JOINT_STATE, read_bag, topics
from kilter_files.formats.joints.lerobot.calibration import NORM_MODES, read_calibration
from kilter_files.formats.joints.lerobot.dataset import Dataset, open_dataset, refuse_unfinished
from kilter_files.formats.joints.lerobot.log import arm_joint_names, log_of_dataset, refuse_leader
from kilter_files.formats.programs.marks import read_targets
from kilter_files.formats.reader import NO_LOG_HINTS, Document, LogHints, column
from kilter_files.formats.registry import has_format, open_source
from kilter_files.ground.errors import FileError, did_you_mean, fault
from kilter_files.ground.later import np
from kilter_files.ground.units import NAMES, column_unit
from kilter_files.tables.source import Layout, TextSource
from kilter_files.tables.table import JointLog, checked_log

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


GAP = 5.0  # a step so many times the usual one is a gap


def describe_bag(path: Path, hints: LogHints) -> Document:
    """Describe a bag: its topics, and the joints of the one that is asked for or the only one."""
    found = topics(path)
    listed = [{"name": t.name, "type": t.kind, "messages": t.messages} for t in found]
    states = [t.name for t in found if t.kind == JOINT_STATE and t.messages]
    if hints.topic is None and len(states) != 1:
        what = f"joint states come from {', '.join(states)}: choose with --topic" if states else "no joint states"
        return {"kind": "bag", "topics": listed, "warnings": [what]}
    joints = None if hints.order else read_bag(path, hints.topic)
    if joints is not None and by_name(joints.names) is None:
        columns = [column(n, "rad or m", joints.positions[:, k]) for k, n in enumerate(joints.names)]
        warnings = ["the names do not tell which joint is the first: give --joint-order", *joints.warnings]
        timing = _timing(joints.t_s)
        warnings += timing.pop("gaps", [])
        return {"kind": "joint-log", "topics": listed, "columns": columns, "warnings": warnings} | timing
    return describe_log(log_of_bag(path, hints)) | {"topics": listed}


def describe_log(log: JointLog) -> Document:
    """Describe a joint log that was read."""
    q, warnings = np.abs(log.q_even()), list(log.warnings)
    if all(name.endswith("_deg") for name in log.joints) and len(log) > 20 and q.max() < 3.2:
        warnings.append("no joint moves by more than 3.2 deg: are these radians?")
    still = [name for name in log.joints if len(log) > 20 and np.ptp(log.columns[name]) == 0]
    if still:
        warnings.append(f"never move: {', '.join(still)}")
    columns = [column(name, column_unit(name), values) for name, values in log.columns.items()]
    notes = [*log.notes, "joins a recording with kilter measure match, points with kilter upload --joints"]
    timing = {} if log.t_s is None else _timing(log.t_s)
    warnings += timing.pop("gaps", [])
    return {"kind": "joint-log", "rows": len(log), "columns": columns, "notes": notes, "warnings": warnings} | timing


def _timing(t: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Document:
    step = np.diff(t)
    if not len(step):
        return {}
    usual = float(np.median(step))
    wide = np.flatnonzero(step > GAP * usual)
    gaps = [f"{len(wide)} gaps in time, the first at {t[wide[0]]:.3f} s"] if len(wide) else []
    return {"rows": len(t), "rate_hz": 1 / usual, "duration_s": float(t[-1] - t[0]), "gaps": gaps}


def describe_dataset(path: Path, hints: LogHints) -> Document:
    """Say what a data set holds; with a calibration, read it whole."""
    if hints.calibration is not None or hints.zero == "old":
        return describe_log(log_of_dataset(path, hints))
    dataset = open_dataset(path)
    refuse_unfinished(dataset)
    notes = [
        dataset.summary_text,
        f"joints {', '.join(dataset.names)}",
    ]
    modes = " or ".join(NORM_MODES)
    warnings = [
        f"nothing says what its numbers mean: give --calibration JSON and --norm-mode {modes}",
        *_refusal_messages(dataset, partial(arm_joint_names, dataset, hints.order)),
    ]
    problems = [{"what": text} for text in _refusal_messages(dataset, partial(refuse_leader, dataset))]
    duration_s = dataset.frames / dataset.fps if dataset.fps else None
    return {
        "kind": "joint-log",
        "rows": dataset.frames,
        "rate_hz": dataset.fps,
        "duration_s": duration_s,
        "notes": notes,
        "warnings": warnings,
        "problems": problems,
    }


def _refusal_messages(dataset: Dataset, check: Callable[[], object]) -> list[str]:
    """What ``check`` has against a data set, without its name; nothing where it passes."""
    try:
        check()
    except FileError as error:
        return [error.detail.removeprefix(f"{dataset.folder}: ").rstrip(".")]
    return []


def describe_calibration(path: Path) -> Document:
    """Say what a calibration holds."""
    found = read_calibration(path)
    notes = [
        f"SHA-256 {found.sha256}",
        "of a leader" if found.of_a_leader else "of a follower, or of neither by its folder",
    ]
    for name, servo in found.servos.items():
        reversed_ = ", reversed" if servo.drive_mode else ""
        notes.append(
            f"servo {servo.id} {name}: homing offset {servo.homing_offset} ticks, range {servo.range_min} to "
            f"{servo.range_max} (+-{servo.half_range_deg:.1f} deg){reversed_}"
        )
    return {"notes": notes, "warnings": found.seam_warnings()}
