"""Nominal kinematics of a stored robot: the flange at joints, and all joints for a flange."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.units import MAX_JOINTS, Deg, Pose, Strict

MAX_ROWS = 10_000
Joints = Annotated[list[Deg], Field(min_length=1, max_length=MAX_JOINTS)]
Poses = Annotated[list[Pose], Field(min_length=1, max_length=MAX_ROWS)]


class JointRows(Strict):
    """Joints of a robot, row by row."""

    joints_deg: Annotated[list[Joints], Field(min_length=1, max_length=MAX_ROWS)] = Field(
        description="Joints of each row, degrees, in the order of the robot."
    )


class Flanges(Strict):
    """Poses of the flange, without the robot's own tool, in the frame of its root, without its base."""

    flanges: Poses = Field(description="The flange in the frame of the robot's root, row by row.")


class Posture(Strict):
    """Joints that bring the flange to a pose, and which of the arm's branches they are."""

    joints_deg: Joints = Field(
        description="Joints, degrees, each within 180 degrees of zero; limits are not looked at."
    )
    front: bool = Field(description="Whether the wrist is on the side of the root's x axis, with joint 1 at zero.")
    elbow_up: bool = Field(description="Whether the elbow, with the wrist in front, is above the line to it.")
    wrist: bool = Field(description="Which of the two bends of joint 5 it is.")
    singular: bool = Field(description="Whether two axes are in line, so that their joints cannot be told apart.")
    named: bool = Field(
        True,
        description="Whether `front`, `elbow_up` and `wrist` tell the branches; those of an arm without a closed form "
        "have no names, and the three are false.",
    )


class Postures(Strict):
    """All joints of each pose."""

    postures: list[list[Posture]] = Field(description="Postures of each row; none: it cannot be reached.")
    certain: list[bool] = Field(
        default_factory=list,
        description="Whether these are surely all, row by row. They are in closed form; else near a singularity they "
        "may not be.",
    )
