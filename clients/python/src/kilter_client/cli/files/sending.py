"""Rows on their way to a campaign: the one that is named or has them already, else a new one.

Rows of an arm of servos are of one calibration: its hash is a condition of the campaign, and the server compares it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from csv import DictReader
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client import Kilter
from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.terminal.output import REMEDY_FOR_COLUMNS, upload_bar
from kilter_client.cli.terminal.references import on_interrupt, resolve_reference
from kilter_client.errors import ConflictError, FileError, KilterError, ObservationError, UsageError
from kilter_client.files import files_formats
from kilter_client.verbs.campaigns import send_rows
from kilter_client.verbs.servo_calibration import CONDITION, compare_calibration
from kilter_files import Prepared
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from kilter_files import Prepared
    from kilter_files.tables import JointLog


def send(
    robot: str, campaign: str | None, wanted: dict[str, Any], file: Path, prepared: Prepared, as_json: bool
) -> dict[str, Any]:
    """Send rows, and say at Ctrl-C what is left of them.

    Raises:
        ObservationError: the rows are not what their columns say; nothing is stored.

    """
    targets: list[tuple[str, bool]] = []
    with Kilter() as kilter:
        into = resolve_reference(kilter, "campaign", campaign, robot, as_json, "--campaign") if campaign else None
        with (
            on_interrupt(partial(_describe_interrupted_send, kilter, targets, prepared.sha256)),
            upload_bar(file.name, as_json) as sent,
        ):
            try:
                return kilter.run(send_rows(robot, into, wanted, prepared, str(file), sent, targets.append))
            except ObservationError as error:
                if not prepared.lines and error.context.get("row") is None and error.code == "observations_invalid":
                    error.detail += f" {REMEDY_FOR_COLUMNS}"
                raise


def _describe_interrupted_send(kilter: Kilter, targets: list[tuple[str, bool]], sha256: str) -> str:
    """Say what is left of rows that were being sent; a new campaign is withdrawn."""
    if not targets:
        return "nothing is stored. The same command sends the file again."
    campaign, new = targets[0]
    return _taken_back(kilter, campaign) if new else _describe_added_rows(kilter, campaign, sha256)


def _taken_back(kilter: Kilter, campaign: str) -> str:
    """Drop a campaign that was broken off, and say what is left of it."""
    try:
        kilter.campaigns.discard(campaign)
    except ConflictError:  # its last request had reached the server
        return f"campaign {campaign} is stored completely."
    except KilterError as error:
        return (
            f"campaign {campaign} is begun but not visible, and could not be withdrawn ({error.detail}). "
            "The same command sends the file again."
        )
    return "nothing is stored. The same command sends the file again."


def _describe_added_rows(kilter: Kilter, campaign: str, sha256: str) -> str:
    """Say whether rows that were being added are there."""
    try:
        there = any(upload["sha256"] == sha256 for upload in kilter.campaigns.get(campaign)["uploads"])
    except KilterError:
        return (
            f"the rows are in campaign {campaign} or not at all. The same command again changes nothing that is there."
        )
    if there:
        return f"the rows are stored in campaign {campaign}."
    return f"nothing is added to campaign {campaign}. The same command sends the file again."


CAMERA = (
    "name",
    "mount",
    "width_px",
    "height_px",
    "fx_px",
    "fy_px",
    "cx_px",
    "cy_px",
    "distortion_model",
    "distortion",
    "intrinsics",
    "sigmas_px",
)
BOARD = ("name", "mount", "corners_mm", "scale_sigma_percent")


def rig_conditions(file: Path) -> dict[str, Any]:
    """Return the conditions ``cameras`` and ``boards`` of a campaign.

    Raises:
        UsageError: not such a file.

    """
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        cameras = [_known_fields(one, CAMERA) for one in document["cameras"]]
        boards = [_known_fields(one, BOARD) for one in document["boards"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            f"--cameras {file}: does not describe cameras and boards ({error}): give the JSON that `kilter measure see` writes."
        ) from error
    if not cameras or not boards:
        what = "boards" if cameras else "cameras"
        raise UsageError(f"--cameras {file}: names no {what}: state the intrinsics when you run `kilter measure see`.")
    return {"cameras": cameras, "boards": boards}


def _known_fields(one: dict[str, Any], known: tuple[str, ...]) -> dict[str, Any]:
    return {name: one[name] for name in known if one.get(name) is not None}


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
