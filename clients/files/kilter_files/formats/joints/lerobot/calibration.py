"""LeRobot's calibration of an arm: for each servo its zero and range in ticks, and what recorded numbers mean with it.

Readings are divided by range (-100 to 100) or given in degrees from the middle of the range, with 4095 ticks to 360
degrees as LeRobot counts. The file does not say which: whoever recorded does.

A calibration stated beside rows in contract columns: whether it can be of that arm, and whether its servos reach them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import did_you_mean, fault
from kilter_files.ground.later import need, np

FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
OLD_FIELDS = {"homing_offset", "drive_mode", "calib_mode"}  # lists, one entry for each motor
TICKS, TURN_TICKS, MOST_OFFSET = 4096, 4095, 2047
BY_RANGE, DEGREES = NORM_MODES = ("RANGE_M100_100", "DEGREES")
TELEOPERATORS, ROBOTS = "teleoperators", "robots"  # the folders in which LeRobot keeps calibrations
LEADER, FOLLOWER = "leader", "follower"
FULL_TURN = "wrist_roll"  # LeRobot gives it all ticks by design
SEAM_TICKS = 8  # a range that ends nearer to the seam of the encoder was probably cut by it
LEAST_RANGE, OUTSIDE_DEG = 10, 1.0  # ticks; beyond the range of its own calibration


@dataclass(frozen=True)
class Servo:
    """A servo as LeRobot calibrated it, in ticks."""

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def half_range_deg(self) -> float:
        """From the middle of its range to an end."""
        return 0.5 * (self.range_max - self.range_min) * 360.0 / TURN_TICKS


@dataclass(frozen=True)
class Calibration:
    """The servos of an arm by name, and the hash of the file: rows of another calibration are those of another arm."""

    path: Path
    servos: Mapping[str, Servo]
    sha256: str

    @property
    def of_a_leader(self) -> bool:
        """Whether LeRobot keeps it among its leaders, or its folder or its own name says so where LeRobot's folders do not."""
        whole = self.path.resolve()
        *_, kept, folder = ("", "", *whole.parent.parts)
        if kept in (TELEOPERATORS, ROBOTS):
            return kept == TELEOPERATORS
        named = (folder.lower(), whole.stem.lower())
        return TELEOPERATORS in whole.parts or any(LEADER in name and FOLLOWER not in name for name in named)

    def seam_warnings(self, used: Collection[str] = ()) -> list[str]:
        """Name each servo, or of those ``used``, whose range ends at the seam of its encoder: its zero is then wrong."""
        return [
            f"servo {name!r}: its range {servo.range_min} to {servo.range_max} ends at the seam of the encoder and was "
            "probably cut there. Its zero is then wrong by tens of degrees. Put the joint into the middle of its travel "
            "and calibrate again, unless it rotates all the way round"
            for name, servo in self.servos.items()
            if not name.endswith(FULL_TURN)
            and (not used or name in used)
            and (servo.range_min <= SEAM_TICKS or servo.range_max >= TICKS - 1 - SEAM_TICKS)
        ]

    def degrees(self, name: str, recorded: Floats, mode: str) -> Floats:
        """Angle (n,) of a servo from the middle of its range, degrees, of what was recorded."""
        if mode == DEGREES:
            return recorded
        servo = self.servos[name]
        return recorded / 100.0 * (-servo.half_range_deg if servo.drive_mode else servo.half_range_deg)

    def recorded_value(self, name: str, angle_deg: float, mode: str, ticks: float = 0.0) -> float:
        """What is recorded of a servo at an angle, or so many of its ``ticks`` beyond it."""
        if mode == DEGREES:
            return angle_deg + ticks * 360.0 / TURN_TICKS
        servo = self.servos[name]
        way = -1.0 if servo.drive_mode else 1.0
        return way * (100.0 * angle_deg / servo.half_range_deg) + way * ticks * 200.0 / (
            servo.range_max - servo.range_min
        )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.

    Raises:
        FileError: it is not a calibration, that of the old zero, or one whose servos wrap or cannot be.

    """
    content = path.read_bytes()
    try:
        found = json.loads(content)
    except ValueError as error:
        raise fault(path, f"is not JSON ({error})", "Take the file that lerobot-calibrate wrote.") from error
    if not isinstance(found, dict) or not found:
        raise fault(path, "holds no servos", "Take the file that lerobot-calibrate wrote.")
    if found.keys() >= OLD_FIELDS:
        raise fault(
            path,
            "is a calibration of the old zero (lists, from before LeRobot 0.2)",
            "Calibrate again with lerobot-calibrate; data recorded with it are read with --zero old.",
        )
    servos = {str(name): _servo(path, str(name), entry) for name, entry in found.items()}
    _refuse_twins(path, servos)
    return Calibration(path, servos, hashlib.sha256(content).hexdigest())


def looks_like_one(start: bytes) -> bool:
    """Tell by the first bytes of a file whether it is a calibration."""
    return start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") and b'"homing_offset"' in start


def servo_name_for_joint(calibration: Calibration, joint: str) -> str:
    """Name in the calibration of a joint of a data set: of one arm of two, the file has it without ``left_``.

    Raises:
        FileError: the calibration has no such servo.

    """
    for name in (joint, joint.removeprefix("left_"), joint.removeprefix("right_")):
        if name in calibration.servos:
            return name
    has = ", ".join(calibration.servos)
    what = f"has no servo {joint!r}{did_you_mean(joint, list(calibration.servos))}: it is of another arm"
    raise fault(calibration.path, what, f"It has {has}. Give the calibration with which the data were recorded.")


def refuse_outside(
    calibration: Calibration,
    path: Path,
    column: str,
    servo: str,
    angles: Floats,
    first_row: int,
    lines: Sequence[int] = (),
) -> None:
    """Refuse angles that the servo does not reach: they were recorded with another calibration.

    ``lines`` of the file are named instead of rows, where they are known.

    Raises:
        FileError: an angle beyond the range.

    """
    reach = calibration.servos[servo].half_range_deg + OUTSIDE_DEG
    far = np.flatnonzero(~(np.abs(angles) <= reach))
    if len(far):
        what = f"{angles[far[0]]:.6g} deg is outside the range of {calibration.path.name} (+-{reach - OUTSIDE_DEG:.4g} deg)"
        remedy = "The rows are of another calibration, or of another norm mode: give those they were recorded with."
        row = int(far[0])
        place = {"line": lines[row]} if row < len(lines) else {"row": first_row + row + 1}
        raise fault(path, what, remedy, **place, column=column)


def _servo(path: Path, name: str, entry: Any) -> Servo:
    if not isinstance(entry, dict) or any(not _whole(entry.get(key)) for key in FIELDS):
        raise fault(path, f"servo {name!r} does not have whole numbers {', '.join(FIELDS)}", "Calibrate it again.")
    servo = Servo(*(int(entry[key]) for key in FIELDS))
    wrong = _impossible(servo)
    if wrong:
        raise fault(path, f"servo {name!r}: {wrong[0]}", wrong[1])
    return servo


def _impossible(servo: Servo) -> Sequence[str]:
    if servo.drive_mode not in (0, 1):
        return f"drive_mode is {servo.drive_mode}", "It is 0, or 1 for a reversed servo."
    if abs(servo.homing_offset) > MOST_OFFSET:
        return (
            f"homing_offset is {servo.homing_offset}, a servo holds {MOST_OFFSET} ticks either way",
            "Put the arm into the middle of its range and calibrate again; else move the horn by a tooth.",
        )
    low, high = servo.range_min, servo.range_max
    if low < 0 or high >= TICKS or high - low < LEAST_RANGE:
        return (
            f"its range is {low} to {high} of 0 to {TICKS - 1} ticks: it wraps within the range, or was not moved",
            "Put the arm into the middle of its range before the zero is taken, and move each joint from end to end.",
        )
    return ()


def _refuse_twins(path: Path, servos: Mapping[str, Servo]) -> None:
    numbers = [servo.id for servo in servos.values()]
    twice = next((number for number in numbers if numbers.count(number) > 1), None)
    if twice is not None:
        raise fault(
            path, f"two servos have id {twice}: calibrations of two arms in one file", "Give the file of one arm."
        )


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


# What a servo adds to its own position: Feetech's take their homing offset off, Dynamixel's add it.
SIGN = {"feetech": -1, "dynamixel": 1}


TICK_DEG = 360.0 / TURN_TICKS


@dataclass(frozen=True)
class Homed:
    """A servo's homing offset, ticks, before and after; ``left_deg`` is what whole ticks cannot hold."""

    servo: str
    before: int
    after: int
    left_deg: float


def with_zero_offsets(
    calibration: Calibration, offsets_deg: Mapping[str, float], mode: str, servos: str
) -> tuple[str, list[Homed]]:
    """Return the text of the calibration with these offsets of its joints (real = reading + offset), and the changes.

    Ranges stay as they are: readings count from their middle, which must not move with the zero.

    Raises:
        FileError: a joint has no servo, or a servo cannot hold the offset.

    """
    document = json.loads(calibration.path.read_bytes())
    changes = []
    for joint, offset in offsets_deg.items():
        name = servo_name_for_joint(calibration, joint)
        servo = calibration.servos[name]
        reversed_ = -1 if servo.drive_mode and mode == BY_RANGE else 1
        ticks = round(offset / TICK_DEG)
        after = servo.homing_offset + SIGN[servos] * reversed_ * ticks
        if abs(after) > MOST_OFFSET:
            raise fault(
                calibration.path,
                f"servo {name!r} would get a homing offset of {after}, it holds {MOST_OFFSET} either way",
                "Move the horn by a tooth and calibrate again.",
            )
        document[name]["homing_offset"] = after
        changes.append(Homed(name, servo.homing_offset, after, offset - ticks * TICK_DEG))
    return json.dumps(document, indent=4), changes


FOLLOWER_ARM = "Give the calibration of the follower, in .../calibration/robots/."
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
        raise fault(path, "is of a leader by its folder or its name, and what is measured is a follower", FOLLOWER_ARM)
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
