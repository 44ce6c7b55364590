"""Points of a tracker or CMM with the joints of another file, row by row, as rows."""

from __future__ import annotations

from pathlib import Path

from kilter_files.ground.faults import fault
from kilter_files.ground.units import JOINT
from kilter_files.match.matching import Columns, pose_numbers, settled
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.table import Table


def columns_beside(joints: JointLog) -> Columns:
    """Return the columns of a joint log that belong beside points: a row for each time the arm came to rest."""
    rows = settled(joints)
    columns = {name: joints.columns[name][rows] for name in joints.joints}
    known = joints.columns["pose_id"][rows] if "pose_id" in joints.columns else pose_numbers(joints, rows)
    return columns | {"pose_id": known}


def checked_points(path: Path, table: Table, joints: JointLog | None) -> Table:
    """Return an export of points that can be sent; the joints are its own, or those of ``joints``.

    Raises:
        FileError: no joints at all; nothing is to be sent then.

    """
    if not any(JOINT.fullmatch(name) for name in table.columns):
        remedy = "Name the file that holds them (--joints), or send the export with a column map (--map)."
        raise fault(path, "holds points, but no joints with a unit", remedy)
    if joints is not None:
        table.notes += [f"joints from {joints.path.name}, row by row", *joints.notes]
        table.warnings += joints.warnings
    return table
