"""ROS 2 bags: the joint log of a controller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.formats.joints.joint_log import describe_bag, log_of_bag
from kilter_files.formats.reader import MATCH, NO_HINTS, Document, Head, Hints, Reader

if TYPE_CHECKING:
    from kilter_files.tables.table import JointLog

METADATA = "metadata.yaml"
MAGIC = (b"\x89MCAP0\r\n", b"SQLite format 3\0")


class Bag(Reader["JointLog"]):
    """A bag: its folder, its metadata.yaml, or one of its files by the first bytes."""

    name = "bag"
    title = "ROS 2 bag with joint states"
    use = MATCH
    endings = (".db3", ".mcap")
    is_a = "a ROS 2 bag"
    instead = "It is the joint log: kilter measure match RECORDING BAG."

    def recognises(self, head: Head) -> bool:
        """A folder with metadata, or a file of SQLite or MCAP."""
        if head.path.is_dir():
            return (head.path / METADATA).is_file()
        return head.path.name == METADATA or head.start.startswith(MAGIC)

    def describe(self, head: Head) -> Document:
        """Topics, and the joints of the one that is asked for or the only one."""
        return describe_bag(head.path, head.hints.log)

    def read(self, path: Path, hints: Hints = NO_HINTS) -> JointLog:
        """Read the joints of a topic."""
        return log_of_bag(path, hints.log)


READER = Bag()
