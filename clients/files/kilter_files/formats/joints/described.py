"""How a joint log is read: a bag's topics and joints, a program's targets."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.column import column
from kilter_files.formats.joints.bag import JOINT_STATE, read_bag, topics
from kilter_files.formats.joints.joint_log import by_name, log_of_bag
from kilter_files.formats.reader import Document, LogHints
from kilter_files.ground.later import np
from kilter_files.ground.units import column_unit
from kilter_files.tables.joint_log import JointLog

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
