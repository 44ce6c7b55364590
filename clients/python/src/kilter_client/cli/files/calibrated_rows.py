"""Rows of an arm of servos are of one calibration: its hash stands with the campaign, and rows of another are refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_client import Kilter
from kilter_client.errors import FileError

if TYPE_CHECKING:
    from kilter_files.tables.joint_log import JointLog

NOTE = re.compile(r"LeRobot calibration, SHA-256 ([0-9a-f]{64})")


def note_of(sha256: str) -> str:
    """Return what stands with a campaign."""
    return f"LeRobot calibration, SHA-256 {sha256}"


def calibrated(robot: str | None, log: JointLog) -> dict[str, str]:
    """Return what a campaign of this log is made with besides; nothing where the log has no calibration.

    Raises:
        FileError: a campaign of the robot was recorded with another one.

    """
    if log.calibration_sha256 is None:
        return {}
    if robot:
        refuse_other_calibration(robot, log.path, log.calibration_sha256)
    return {"notes": note_of(log.calibration_sha256)}


def refuse_other_calibration(robot: str, path: Path, sha256: str) -> None:
    """Compare the calibration of rows with that of the robot's campaigns.

    Raises:
        FileError: a campaign of the robot was recorded with another one: its zeros are those of another arm.

    """
    with Kilter() as kilter:
        campaigns = kilter.campaigns.list(robot)
    for campaign in campaigns:
        found = NOTE.search(campaign.get("notes") or "")
        if found and found[1] != sha256:
            raise FileError(
                f"{path}: was recorded with calibration {sha256[:12]}, campaign {campaign['name']!r} of {robot} with "
                f"{found[1][:12]}: since a new calibration it is another arm. Add a robot for it, or retire the campaign.",
                code="calibration_differs",
                file=str(path),
            )
