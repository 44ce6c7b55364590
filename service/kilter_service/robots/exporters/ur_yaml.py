"""A version as the calibration YAML of Universal Robots' ROS driver: joint origins in the frame of the joint before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.arm import JointFrames, Screws, joint_frames
from kilter_core.errors import RobotError
from kilter_core.model import arm_screws, flange_screws, wanted_tool
from kilter_core.transforms import inverse, xyz_rpy_from_pose
from kilter_core.types import Floats
from kilter_service.robots.exporters.exportable import Exportable, Written, omissions
from kilter_service.robots.importers.urdf_tree import parse

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
SAID_M, SAID_RAD = 1e-9, 1e-9


def ur_yaml(version: Exportable) -> Written:
    """Write the YAML.

    Raises:
        RobotError: the robot does not have exactly six revolute joints.

    """
    calibration = version.calibration
    flange = flange_screws(calibration).one_axis_per_joint()
    if len(flange) != 6 or flange.prismatic.any():
        raise RobotError("The YAML of Universal Robots is for six revolute joints: take urdf or mdh-csv.")
    before = _first_parent(version)
    frames = _with_the_flange(
        joint_frames(_level_with_the_flange(flange.compose_with_poses(inverse(before), np.eye(4))))
    )
    tool = frames.end @ wanted_tool(calibration)
    notes = (*omissions(calibration, arm_screws(calibration)), *_tool_note(frames.end, tool))
    notes = (*notes, "The driver compares the hash with the arm's own and will say that they differ: they should.")
    lines = [f"# {note}" for note in notes] + ["kinematics:"]
    for name, origin in zip(LINKS, frames.origin, strict=True):
        xyz, rpy = xyz_rpy_from_pose(origin)
        lines += [f"  {name}:"]
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        lines += [f"    {key}: {float(value)!r}" for key, value in zip(keys, (*xyz, *rpy), strict=True)]
    lines += [f"  hash: kilter_{version.version.id}"]
    return Written("\n".join(lines) + "\n", notes)


def _level_with_the_flange(flange: Screws) -> Screws:
    """Put the last joint's origin where the flange is, as the driver expects it."""
    point, z, home = flange.point.copy(), flange.direction[-1], flange.home
    point[-1] = point[-1] + z * ((home[:3, 3] - point[-1]) @ z)
    return replace(flange, point=point)


def _with_the_flange(frames: JointFrames) -> JointFrames:
    """Rotate the last joint's frame about its axis until its x is the flange's."""
    angle = np.arctan2(frames.end[1, 0], frames.end[0, 0])
    rotation, origin = np.eye(4), frames.origin.copy()
    rotation[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    origin[-1] = origin[-1] @ rotation
    return JointFrames(origin, inverse(rotation) @ frames.end)


def _first_parent(version: Exportable) -> Floats:
    """Pose (4, 4) in the robot's base frame of the body that carries the shoulder: a URDF has fixed joints before it."""
    robot = version.robot
    if robot["convention"] != "urdf":
        return np.eye(4)
    T = np.eye(4)
    for joint in parse(robot["urdf"]).path(robot["base_link"], robot["tip_link"]):
        if joint.moves:
            break
        T = T @ joint.origin
    return T


def _tool_note(end: Floats, tool: Floats) -> tuple[str, ...]:
    """Say the tool frame to set where the identified flange is not on the last joint's frame."""
    xyz, rpy = xyz_rpy_from_pose(end)
    if np.abs(xyz).max() < SAID_M and np.abs(rpy).max() < SAID_RAD:
        return ()
    xyz, rpy = xyz_rpy_from_pose(tool)
    millimetres = ", ".join(f"{v * 1e3:.4f}" for v in xyz)
    degrees = ", ".join(f"{v:.5f}" for v in np.degrees(rpy))
    return (
        f"Set the tool frame behind wrist_3 to x, y, z = {millimetres} mm and roll, pitch, yaw = {degrees} deg: "
        "the calibrated flange is not on the last axis, which this file cannot express.",
    )
