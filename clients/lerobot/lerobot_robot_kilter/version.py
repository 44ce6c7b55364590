"""The version that corrects an arm, from the server; and whether the arm's servos are still those it was measured with."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kilter_client import Kilter
from kilter_client.bridges import versions
from kilter_client.errors import ConflictError, FileError, UsageError
from kilter_core.correct import Stored, from_bytes

CONDITION = "calibration_sha256"


@dataclass(frozen=True)
class Used:
    """A version as it corrects: its robot, joints in order, program, and the servo calibration of each of its campaigns."""

    robot: str
    version_id: str
    joints: tuple[str, ...]
    stored: Stored
    calibrations: Mapping[str, str | None]


def fetch_used_version(robot: str, version: str | None = None, force: bool = False) -> Used:
    """Fetch what corrects a robot.

    Raises:
        ConflictError: no version is active, or the arm would be corrected twice.
        UsageError: no robot is named.

    """
    if not robot:
        raise UsageError("Say which robot of the Kilter server this arm is: --robot.kilter_robot=NAME.")
    found = versions.fetch_startup_version(robot, version, force)
    with Kilter() as kilter:
        joints = tuple(str(joint["name"]) for joint in kilter.robots.get(robot)["joints"])
        campaigns = [str(one["id"]) for one in kilter.versions.get(found.version_id, robot=robot)["campaigns"]]
        stated = {one: kilter.campaigns.get(one)["conditions"].get(CONDITION) for one in campaigns}
    return Used(robot, found.version_id, joints, from_bytes(found.program), stated)


def refuse_other_calibration(found: Used, calibration: Path) -> None:
    """Compare the calibration of the servos with that of the version's campaigns.

    Raises:
        FileError: the arm has no calibration.
        ConflictError: the campaigns were measured with another one, or nobody stated with which.

    """
    if not calibration.is_file():
        raise FileError(
            f"{calibration}: is missing. Give --robot.id the name under which the arm was calibrated, or calibrate and measure "
            "it as so101_follower first.",
            file=str(calibration),
        )
    own = hashlib.sha256(calibration.read_bytes()).hexdigest()
    for campaign, stated in found.calibrations.items():
        if stated is None:
            raise ConflictError(
                f"Campaign {campaign} of version {found.version_id} does not state with which calibration of the servos "
                "it was measured. Upload its rows again with --calibration JSON, and identify anew.",
                code="calibration_differs",
            )
        if stated != own:
            raise ConflictError(
                f"{calibration}: its SHA-256 is {own[:12]}, campaign {campaign} of version {found.version_id} was measured "
                f"with {stated[:12]}: with other zeros it is another arm. Put that calibration back, or measure it and "
                "identify anew.",
                code="calibration_differs",
            )
