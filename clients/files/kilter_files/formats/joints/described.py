"""How a joint log is read: a bag's topics and joints, a program's targets."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from kilter_files.formats.column import column
from kilter_files.formats.joints.bag import JOINT_STATE, read_bag, topics
from kilter_files.formats.joints.joint_log import by_name, log_of_bag
from kilter_files.formats.joints.lerobot.calibration import NORM_MODES, read_calibration
from kilter_files.formats.joints.lerobot.dataset import Dataset, open_dataset, refuse_unfinished
from kilter_files.formats.joints.lerobot.log import arm_joint_names, log_of_dataset, refuse_leader
from kilter_files.formats.reader import Document, LogHints
from kilter_files.ground.errors import FileError
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
