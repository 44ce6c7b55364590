"""What Kilter says of robots: lists, reports, checks, circles, and nominal kinematics."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field, model_validator

from kilter_service.contract.robots import RobotDocument
from kilter_service.contract.units import (
    COMPENSATION,
    INTERVAL,
    MAX_JOINTS,
    TOLERANCE,
    ControllerCompensation,
    Deg,
    Direction,
    Drive,
    JointType,
    Listed,
    Mm,
    PointMm,
    Pose,
    Strict,
)
from kilter_service.contract.wording import RETIRED_AT

DRIVES = "Axes that follow a joint (mimic, parallelogram) and who carries the load on them, in words."
KIND = "Whether the joint is revolute or prismatic."


class JointSummary(Strict):
    """A joint as Kilter understood it."""

    name: str = Field(description="Name of the joint.")
    kind: JointType = Field(description=KIND)
    limits_deg: tuple[Deg | None, Deg | None] | None = Field(
        None, description="Lowest and highest reading of a revolute joint, degrees; null at an end that is open."
    )
    limits_mm: tuple[Mm | None, Mm | None] | None = Field(
        None, description="Lowest and highest reading of a prismatic joint, mm; null at an end that is open."
    )
    gear_ratio: float | None = Field(None, description="Turns of the motor per turn of the joint, where it is known.")
    drive_stiffness_nm_rad: float | None = Field(
        None, description="Rough stiffness of the drive, N m/rad, where it is known."
    )

    @model_validator(mode="after")
    def _one_unit(self) -> JointSummary:
        assert (self.limits_deg is None) != (self.limits_mm is None)
        return self


class RobotSummary(Strict):
    """A robot in a list."""

    name: str = Field(description="Name of the robot.")
    convention: str = Field(description="Convention of the document it was posted as.")
    created_at: datetime = Field(description="When it was added.")
    campaigns: int = Field(description="How many campaigns it has.")
    versions: int = Field(description="How many versions it has.")
    active_version: str | None = Field(description="The version it is corrected with; null: none.")
    remarks: str = Field("", description="What people noted on the robot.")
    controller_compensation: ControllerCompensation = Field("unknown", description=COMPENSATION)
    controller_sentence: str = Field("", description="The same, and what follows from it, in words.")
    tolerance_mm: Mm | None = Field(None, description=f"{TOLERANCE} Null: none.")
    check_interval_days: int | None = Field(None, description=f"{INTERVAL} Null: none.")
    retired_at: datetime | None = Field(None, description=RETIRED_AT)


class RobotReport(RobotSummary):
    """A robot with its joints, the names of its geometric parameters, and the document it was posted as."""

    joints: list[JointSummary] = Field(description="Joints from base to tool.")
    parameters: list[str] = Field(description="Names of the geometric parameters, without base and tool.")
    notes: list[str] = Field(description="What of the document was left out, in words.")
    drives: list[str] = Field([], description=DRIVES)
    sha256: str = Field(
        description="SHA-256 of the chain that the document was resolved to when it was posted, 64 hexadecimal digits."
    )
    source_sha256: str = Field(
        description="SHA-256 of the posted document, of a URDF that of its text, 64 hexadecimal digits."
    )
    document: RobotDocument = Field(
        description="The document as it was posted, with what the controller is said to do now."
    )


class RobotList(Listed):
    """All robots, by name."""

    robots: list[RobotSummary] = Field(description="Robots, by name.")


class AxisReport(Strict):
    """An axis at zero, in the frame in which the pose of the base is given; a joint that drives several axes has several."""

    joint: str = Field(description="Name of the joint that drives it.")
    kind: JointType = Field(description=KIND)
    ratio: float = Field(description="Motion of the axis per motion of the joint, no unit.")
    drive: Drive | None = Field(
        None, description="Who carries the load on an axis that follows the joint; null: its own axis, or nobody said."
    )
    point_mm: PointMm = Field(description="A point on the axis, mm.")
    direction: Direction = Field(description="Direction of the axis, of length 1.")
    angle_to_previous_deg: Deg | None = Field(
        description="Angle to the axis before, 0 to 180 degrees; null for the first."
    )
    distance_to_previous_mm: Mm | None = Field(
        description="Shortest distance to the axis before, mm; null for the first."
    )


class Zero(Strict):
    """The arm at zero: base, a point on each axis, flange and tool point; and the tool's pose."""

    points_mm: list[PointMm] = Field(description="Base, a point on each axis, flange and tool point, mm.")
    tool: Pose = Field(description="Pose of the tool point.")


class RobotCheck(Strict):
    """What a robot document comes to; ``suspicious`` is what looks wrong and may be right."""

    name: str = Field(description="Name of the robot.")
    joints: list[JointSummary] = Field(description="Joints from base to tool.")
    axes: list[AxisReport] = Field(description="Axes from base to tool, all joints at zero.")
    zero: Zero = Field(description="The arm at zero.")
    reach_mm: Mm = Field(description="Largest distance of the tool point from the first axis, mm.")
    drives: list[str] = Field([], description=DRIVES)
    suspicious: list[str] = Field(description="What looks wrong and may be right, in words.")
    notes: list[str] = Field(description="What of the document was left out, in words.")


class CircleAxis(Strict):
    """What an axis rests on: its rows, its arc (or stroke), the widest radius, and how well direction and place are known."""

    joint: str = Field(description="Name of the joint.")
    kind: JointType = Field(description=KIND)
    rows: int = Field(description="Rows in which only this joint moved.")
    arc_deg: Deg | None = Field(description="Arc the joint moved over, degrees; null for a prismatic joint.")
    stroke_mm: Mm | None = Field(description="Stroke the joint moved over, mm; null for a revolute joint.")
    radius_mm: Mm | None = Field(description="Radius of the widest circle, mm; null for a prismatic joint.")
    rms_mm: Mm = Field(description="Rms distance of the points from the circle or line, mm.")
    sigma_deg: Deg = Field(description="Standard deviation of the direction, degrees.")
    sigma_mm: Mm = Field(description="Standard deviation of the place, mm.")


class FoundRobot(Strict):
    """A robot document to add, its axes, and how far the whole is from the rows."""

    robot: RobotDocument = Field(description="The document, ready to be added.")
    axes: list[CircleAxis] = Field(description="What each axis rests on, from base to tool.")
    rms_mm: Mm = Field(description="Rms distance of the rows from what the robot predicts, mm.")


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
