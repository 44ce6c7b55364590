"""Points of a tracker or CMM with the joints of another file, row by row, as rows."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.reader import Hints, LogHints
from kilter_files.formats.registry import all_readers
from kilter_files.formats.tracker_header import PRESETS
from kilter_files.ground.errors import UsageError, fault
from kilter_files.ground.units import JOINT
from kilter_files.match.matching import Columns, pose_numbers, pose_row_indices
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.table import Table


def read_points(path: Path, preset: str, euler: str | None, joints: Path | None, hints: LogHints | None) -> Table:
    """Read an export of points; its joints are its own, or those of the log ``joints``, row by row.

    Raises:
        FileError: the export or the log is not what it should be, or there are no joints at all.
        UsageError: a preset that there is not.

    """
    if preset not in PRESETS:
        raise UsageError(f"--preset {preset}: is not one of {', '.join(PRESETS)}.")
    log = None if joints is None else read_joint_log(joints, hints or LogHints())
    beside = None if log is None else joint_columns_at_rest(log)
    table: Table = all_readers()["tracker-text"].read(path, Hints(preset=preset, euler=euler, joints=beside))
    if not any(JOINT.fullmatch(name) for name in table.columns):
        remedy = "Name the file that holds them (--joints), or send the export with a column map (--map)."
        raise fault(path, "holds points, but no joints with a unit", remedy)
    if log is not None:
        table.notes += [f"joints from {log.path.name}, row by row", *log.notes]
        table.warnings += log.warnings
    return table


def joint_columns_at_rest(joints: JointLog) -> Columns:
    """Return the columns of a joint log that belong beside points: a row for each time the arm came to rest."""
    rows = pose_row_indices(joints)
    columns = {name: joints.columns[name][rows] for name in joints.joints}
    known = joints.columns["pose_id"][rows] if "pose_id" in joints.columns else pose_numbers(joints, rows)
    return columns | {"pose_id": known}
