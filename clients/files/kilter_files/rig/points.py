"""Points of a tracker or CMM with the joints of another file, row by row, ready for upload."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.points.tracker_text import read_tracker
from kilter_files.ground.faults import fault
from kilter_files.ground.units import JOINT
from kilter_files.match.matching import Columns, pose_numbers, settled
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.table import Prepared


def prepare_points(path: Path, preset: str, euler: str | None = None, joints: JointLog | None = None) -> Prepared:
    """Read a text export by its preset; the joints are the export's own or those of ``joints``, in the same order.

    Raises:
        FileError: the export is damaged, no joints at all, or another number of them; nothing is to be sent then.

    """
    table = read_tracker(path, preset, euler, None if joints is None else _columns(joints))
    if not any(JOINT.fullmatch(name) for name in table.columns):
        remedy = "Name the file that holds them (--joints), or send the export with a column map (--map)."
        raise fault(path, "holds points, but no joints with a unit", remedy)
    if joints is not None:
        table.notes += [f"joints from {joints.path.name}, row by row", *joints.notes]
        table.warnings += joints.warnings
    return Prepared.from_table(table)


def _columns(joints: JointLog) -> Columns:
    rows = settled(joints)
    columns = {name: joints.columns[name][rows] for name in joints.joints}
    known = joints.columns["pose_id"][rows] if "pose_id" in joints.columns else pose_numbers(joints, rows)
    return columns | {"pose_id": known}
