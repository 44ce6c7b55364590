"""The calibration of the servos that read the joints of rows: compared with robot and rows, a condition of the campaign."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_client.files import files_formats, files_look
from kilter_client.requests.calls import robots
from kilter_client.requests.steps import Document, Steps

if TYPE_CHECKING:
    from kilter_files import Prepared
    from kilter_files.formats import Calibration

CONDITION = "calibration_sha256"


def compare_calibration_file(
    robot: str, calibration: str | PathLike[str] | None, prepared: Prepared, file: str
) -> Steps[tuple[Document, Prepared]]:
    """Return the condition that a calibration is, and the rows with what was not compared; nothing without one.

    Raises:
        FileError: it is not a calibration, it is of a leader or of another arm, or its servos do not reach a reading.

    """
    if calibration is None:
        return {}, prepared
    return (yield from compare_calibration(robot, files_formats.of_follower(Path(fspath(calibration))), prepared, file))


def compare_calibration(
    robot: str, found: Calibration, prepared: Prepared, file: str
) -> Steps[tuple[Document, Prepared]]:
    """Return the condition that a follower's calibration is, and the rows with what was not compared or looks wrong.

    Raises:
        FileError: it is of another arm, or its servos do not reach a reading.

    """
    joints = [str(joint["name"]) for joint in (yield from robots.fetch_document(robot))["joints"]]
    servos = files_formats.servo_by_joint(found, joints)
    shown = {
        f"{name.partition('_')[0]}_{unit}": values
        for name, given in files_look.numeric_columns(prepared).items()
        for unit, values in [files_look.in_shown_unit(name, given)]
    }
    files_formats.refuse_unreached(found, Path(file), shown, servos, prepared.lines)
    told = found.seam_warnings(servos.values())
    if not servos:
        told.append(files_formats.NOT_COMPARED.format(file=found.path, joints=", ".join(joints)))
    prepared = replace(prepared, warnings=(*prepared.warnings, *told))
    return {CONDITION: found.sha256}, prepared
