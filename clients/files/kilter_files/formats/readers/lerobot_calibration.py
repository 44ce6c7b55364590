"""LeRobot's calibration of an arm: what the numbers of its data sets mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.joints.joint_log import describe_calibration
from kilter_files.formats.joints.lerobot.calibration import looks_like_one, read_calibration
from kilter_files.formats.reader import MATCH, NO_HINTS, Document, Head, Hints, Reader

if TYPE_CHECKING:
    from kilter_files.formats.joints.lerobot.calibration import Calibration


class LeRobotCalibration(Reader["Calibration"]):
    """A JSON object with ticks for each servo."""

    name = "lerobot-calibration"
    title = "LeRobot calibration, beside a data set (--calibration)"
    use = MATCH
    endings = (".json",)
    is_a = "a LeRobot calibration"
    instead = "It says what the numbers of a data set mean: give it with --calibration."

    def recognises(self, head: Head) -> bool:
        """An object whose first servo has a homing offset."""
        return looks_like_one(head.start)

    def describe(self, head: Head) -> Document:
        """The servos with their ranges."""
        return describe_calibration(head.path)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Calibration:
        """Read the servos."""
        return read_calibration(path)


READER = LeRobotCalibration()
