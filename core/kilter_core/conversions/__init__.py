"""One arm in other words: joint axes (product of exponentials), DH and MDH tables, joint frames; the poses stay the same."""

from kilter_core.arm.conversions.documents import load_document, pose_document, robot_document
from kilter_core.arm.conversions.frames import JointFrames, joint_frames
from kilter_core.arm.conversions.screws import Screws, chain_frames, screws_of_chain
from kilter_core.arm.conversions.tables import Table, link_table
from kilter_core.model.geometry import FlangeFrames, arm_screws, flange_frames, flange_screws, wanted_tool

__all__ = [
    "FlangeFrames",
    "JointFrames",
    "Screws",
    "Table",
    "arm_screws",
    "chain_frames",
    "flange_frames",
    "flange_screws",
    "joint_frames",
    "link_table",
    "load_document",
    "pose_document",
    "robot_document",
    "screws_of_chain",
    "wanted_tool",
]
