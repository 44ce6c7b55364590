"""Zero offsets of an arm as homing offsets of its servos, to the tick: a copy of the calibration, and what changed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from kilter_files.formats.joints.lerobot.calibration import (
    BY_RANGE,
    MOST_OFFSET,
    TURN_TICKS,
    Calibration,
    servo_name_for_joint,
)
from kilter_files.ground.faults import fault

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
