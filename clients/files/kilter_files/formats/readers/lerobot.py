"""Data sets of LeRobot: what an arm's servos read, episode after episode."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.joints.joint_log import describe_dataset
from kilter_files.formats.joints.lerobot.log import log_of_dataset
from kilter_files.formats.reader import MATCH, NO_HINTS, Document, Head, Hints, Reader

if TYPE_CHECKING:
    from kilter_files.tables.table import JointLog

INFO = Path("meta") / "info.json"
VERSION = b'"codebase_version"'


class LeRobot(Reader["JointLog"]):
    """A folder with meta/info.json, or that file."""

    name = "lerobot"
    title = "LeRobot data set (v2.1, v3.0)"
    use = MATCH
    is_a = "a LeRobot data set"
    instead = "It is the joint log: kilter measure match RECORDING FOLDER --calibration JSON --norm-mode MODE."

    def recognises(self, head: Head) -> bool:
        """A folder with its description, or the description."""
        if head.path.is_dir():
            return (head.path / INFO).is_file()
        return head.path.name == INFO.name and VERSION in head.start

    def describe(self, head: Head) -> Document:
        """Episodes and joints; with a calibration the joints as they are read."""
        return describe_dataset(head.path, head.hints.log)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> JointLog:
        """Read the joints of all episodes."""
        return log_of_dataset(path, hints.log)


READER = LeRobot()
