"""Nominal kinematics of a stored robot: the flange at joints, and all joints for a flange."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.units import MAX_JOINTS, Deg, Mm, PointMm, Pose, Strict


class KnownPoint(Strict):
    """A point whose place in the frame is known, as the device measured it."""

    name: Annotated[str, Field(max_length=64)] = Field("", description="Name of the point; left out: its number.")
    known_mm: PointMm = Field(description="Where it is in the frame, mm.")
    measured_mm: PointMm = Field(description="Where the device measured it, mm.")


class Features(Strict):
    """Points on the frame's xy plane, along its x axis (first to last), and one above or below its origin."""

    plane_mm: Annotated[list[PointMm], Field(min_length=3, max_length=10_000)] = Field(
        description="Points on the frame's xy plane, mm, three or more."
    )
    line_mm: Annotated[list[PointMm], Field(min_length=2, max_length=10_000)] = Field(
        description="Points along the frame's x axis, from first to last, mm, two or more."
    )
    origin_mm: PointMm = Field(description="A point above or below the frame's origin, mm.")


class NewFrame(Strict):
    """Known points, or features: one of them."""

    points: Annotated[list[KnownPoint], Field(min_length=1, max_length=10_000)] | None = Field(
        None, description="Points that are known in the frame; not with `features`."
    )
    features: Features | None = Field(None, description="Plane, line and origin; not with `points`.")


class OffPoint(Strict):
    """How far a point is from where the frame has it."""

    name: str = Field(description="Name of the point.")
    left_mm: Mm = Field(description="Distance between the point as measured and as the frame has it, mm.")


class Frame(Strict):
    """The frame's pose in the device's coordinates, as `base` of a robot that stands on it; and how well the points fit."""

    pose: Pose = Field(description="The frame in the device's coordinates.")
    rms_mm: Mm = Field(description="Rms distance of the points from where the frame has them, mm.")
    points: list[OffPoint] = Field(description="The distance of each point.")


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
