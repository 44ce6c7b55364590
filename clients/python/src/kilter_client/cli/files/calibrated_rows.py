"""Rows of an arm of servos are of one calibration: its hash is a condition of the campaign, and the server compares it."""

from __future__ import annotations

from collections.abc import Sequence
from csv import DictReader
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client import Kilter
from kilter_client.cli.files.inspect import check_numpy
from kilter_client.errors import FileError, KilterError
from kilter_client.files import files_formats
from kilter_client.verbs.servo_calibration import CONDITION, compare_calibration
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from kilter_files import Prepared
    from kilter_files.tables import JointLog


def calibration_conditions(log: JointLog) -> dict[str, Any]:
    """Return what a campaign of this log is made with besides; nothing where the log has no calibration."""
    return {} if log.calibration_sha256 is None else {"conditions": {CONDITION: log.calibration_sha256}}


def refuse_other_servos(calibration: Path, joints: Sequence[str]) -> None:
    """Refuse a calibration that cannot be that of a follower with these joints.

    Raises:
        FileError: it is not a calibration, it is of a leader, or it lacks the servo of a joint.

    """
    check_numpy()
    found = files_formats.of_follower(calibration)
    for joint in joints:
        files_formats.servo_name_for_joint(found, joint)


def refuse_readings_outside(calibration: Path, views: Sequence[Path], joints: Sequence[str]) -> None:
    """Refuse views whose joints (``q1_deg`` ...) the servos of a calibration do not reach: they are of another one.

    Raises:
        FileError: an angle beyond the range, with file, row and column.

    """
    found = files_formats.read_calibration(calibration)
    for file in views:
        with file.open(encoding="utf-8", newline="") as lines:
            rows = list(DictReader(lines))
        for j, joint in enumerate(joints, 1):
            angles = np.array([float(row[f"q{j}_deg"]) for row in rows])
            servo = files_formats.servo_name_for_joint(found, joint)
            files_formats.refuse_outside(found, file, f"q{j}_deg", servo, angles, 0)


def servo_conditions(calibration: Path) -> dict[str, Any]:
    """Return the condition that the calibration of the servos is.

    Raises:
        FileError: it is not a calibration, or it is of a leader.

    """
    return {CONDITION: files_formats.of_follower(calibration).sha256}


def stated_servos(
    robot: str, calibration: Path, prepared: Prepared, file: Path, dry_run: bool
) -> tuple[dict[str, Any], Prepared]:
    """Return the condition that the calibration of the servos is, compared with robot and rows.

    A dry run compares what can be compared without a server, where none answers.

    Raises:
        FileError: it is not a calibration, it is of a leader or of another arm, or its servos do not reach a reading.

    """
    check_numpy()
    found = files_formats.of_follower(calibration)
    try:
        with Kilter() as kilter:
            return kilter.run(compare_calibration(robot, found, prepared, str(file)))
    except FileError:
        raise
    except KilterError:
        if not dry_run:
            raise
        return {CONDITION: found.sha256}, prepared
