"""One arm in other words: joint axes (product of exponentials), DH and MDH tables, joint frames; the poses stay the same."""

from kilter_core.arm.conversions.documents import drive_document, load_document, pose_document, robot_document
from kilter_core.arm.conversions.tables import (
    JointFrames,
    Screws,
    Table,
    chain_frames,
    joint_frames,
    link_table,
    screws_of_chain,
)

__all__ = [
    "JointFrames",
    "Screws",
    "Table",
    "chain_frames",
    "drive_document",
    "joint_frames",
    "link_table",
    "load_document",
    "pose_document",
    "robot_document",
    "screws_of_chain",
]
