"""A calibration stated beside rows in contract columns: whether it can be of that arm, and whether its servos reach them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from kilter_files.formats.joints.lerobot.calibration import (
    Calibration,
    read_calibration,
    refuse_outside,
    servo_name_for_joint,
)
from kilter_files.ground.errors import fault
from kilter_files.ground.later import need, np

FOLLOWER = "Give the calibration of the follower, in .../calibration/robots/."
NOT_COMPARED = (
    "no servo of {file} is called as a joint of the robot ({joints}), so nobody compared whether the calibration is of this "
    "arm and whether its servos reach these readings"
)


def of_follower(path: Path) -> Calibration:
    """Read the calibration of an arm that was measured.

    Raises:
        FileError: it is not a calibration, or it is of a leader.

    """
    found = read_calibration(path)
    if found.of_a_leader:
        raise fault(path, "is of a leader by its folder or its name, and what is measured is a follower", FOLLOWER)
    return found


def servo_by_joint(calibration: Calibration, joints: Sequence[str]) -> dict[int, str]:
    """Return the servo of each joint of a robot, from 1; none where a description calls its joints in another way.

    Raises:
        FileError: it is of another arm: it has too few servos, or not those of joints that are called as servos are.

    """
    if len(calibration.servos) < len(joints):
        what = f"has {len(calibration.servos)} servos, the robot {len(joints)} joints: it is of another arm"
        raise fault(calibration.path, what, "Give the calibration of the arm that was measured.")
    if not any(_is_matching_servo(joint, servo) for joint in joints for servo in calibration.servos):
        return {}
    return {number: servo_name_for_joint(calibration, joint) for number, joint in enumerate(joints, 1)}


def refuse_unreached(
    calibration: Calibration,
    file: Path,
    columns: Mapping[str, Sequence[float]],
    servos: Mapping[int, str],
    lines: Sequence[int] = (),
) -> None:
    """Refuse readings that the servos do not reach: ``columns`` are ``q1_deg`` ... in degrees, ``servos`` by joint from 1.

    ``lines`` are those of the file behind each row, where they are known. Empty cells are another's to refuse.

    Raises:
        FileError: an angle beyond the range, with its place: the rows are of another calibration.

    """
    need("To compare rows with a calibration needs", "numpy")
    for number, servo in servos.items():
        name = f"q{number}_deg"
        if name in columns:
            angles = np.nan_to_num(np.array(columns[name], dtype=float))
            refuse_outside(calibration, file, name, servo, angles, 0, lines)


def _is_matching_servo(joint: str, servo: str) -> bool:
    """Whether a name is the other one, or that with something before it: ``arm_elbow_flex`` and ``elbow_flex``."""
    return joint.endswith(servo) or servo.endswith(joint)
