"""What the server answers about robots, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from kilter_client.results.record import Record, Records


class JointSummary(Record):
    """A joint as Kilter understood it."""

    drive_stiffness_nm_rad: float | None
    """Rough stiffness of the drive, N m/rad, where it is known."""
    gear_ratio: float | None
    """Turns of the motor per turn of the joint, where it is known."""
    kind: str
    """Whether the joint is revolute or prismatic."""
    limits_deg: tuple[float | None, ...]
    """Lowest and highest reading of a revolute joint, degrees; None at an end that is open."""
    limits_mm: tuple[float | None, ...]
    """Lowest and highest reading of a prismatic joint, mm; None at an end that is open."""
    name: str
    """Name of the joint."""


class RobotSummary(Record):
    """A robot in a list."""

    active_version: str | None
    """The version it is corrected with; None: none."""
    campaigns: int
    """How many campaigns it has."""
    controller_compensation: str
    """Whether the controller corrects the arm by itself: `none`; `factory`: by its maker's calibration; `kilter`: by a calibration that Kilter exported; `unknown`: nobody said."""
    controller_sentence: str
    """The same, and what follows from it, in words."""
    convention: str
    """Convention of the document it was posted as."""
    created_at: str
    """When it was added."""
    name: str
    """Name of the robot."""
    remarks: str
    """What people noted on the robot."""
    retired_at: str | None
    """Since when it is out of use; None: it is in use."""
    versions: int
    """How many versions it has."""


class RobotReport(RobotSummary):
    """A robot with its joints, the names of its geometric parameters, and the document it was posted as."""

    RENAMED: ClassVar[Mapping[str, str]] = {"posted": "document"}
    posted: Mapping[str, Any]
    """The document as it was posted, with what the controller is said to do now."""
    drives: tuple[str, ...]
    """Axes that follow a joint (mimic, parallelogram) and who carries the load on them, in words."""
    joints: Records[JointSummary]
    """Joints from base to tool."""
    notes: tuple[str, ...]
    """What of the document was left out, in words."""
    parameters: tuple[str, ...]
    """Names of the geometric parameters, without base and tool."""
    sha256: str
    """SHA-256 of the chain that the document was resolved to when it was posted, 64 hexadecimal digits."""
    source_sha256: str
    """SHA-256 of the posted document, of a URDF that of its text, 64 hexadecimal digits."""


class AxisReport(Record):
    """An axis at zero, in the frame in which the pose of the base is given; a joint that drives several axes has several."""

    angle_to_previous_deg: float | None
    """Angle to the axis before, 0 to 180 degrees; None for the first."""
    direction: tuple[float, ...]
    """Direction of the axis, of length 1."""
    distance_to_previous_mm: float | None
    """Shortest distance to the axis before, mm; None for the first."""
    drive: str | None
    """Who carries the load on an axis that follows the joint; None: its own axis, or nobody said."""
    joint: str
    """Name of the joint that drives it."""
    kind: str
    """Whether the joint is revolute or prismatic."""
    point_mm: tuple[float, ...]
    """A point on the axis, mm."""
    ratio: float
    """Motion of the axis per motion of the joint, no unit."""


class Pose(Record):
    """A frame: position, then Rz Ry Rx (the convention of URDF)."""

    rx_deg: float
    """Rotation about x, degrees: the first of Rz Ry Rx to act."""
    ry_deg: float
    """Rotation about y, degrees."""
    rz_deg: float
    """Rotation about z, degrees: the last to act."""
    x_mm: float
    """Position along x, mm."""
    y_mm: float
    """Position along y, mm."""
    z_mm: float
    """Position along z, mm."""


class Zero(Record):
    """The arm at zero: base, a point on each axis, flange and tool point; and the tool's pose."""

    points_mm: tuple[tuple[float, ...], ...]
    """Base, a point on each axis, flange and tool point, mm."""
    tool: Pose
    """Pose of the tool point."""


class RobotCheck(Record):
    """What a robot document comes to; ``suspicious`` is what looks wrong and may be right."""

    axes: Records[AxisReport]
    """Axes from base to tool, all joints at zero."""
    drives: tuple[str, ...]
    """Axes that follow a joint (mimic, parallelogram) and who carries the load on them, in words."""
    joints: Records[JointSummary]
    """Joints from base to tool."""
    name: str
    """Name of the robot."""
    notes: tuple[str, ...]
    """What of the document was left out, in words."""
    reach_mm: float
    """Largest distance of the tool point from the first axis, mm."""
    suspicious: tuple[str, ...]
    """What looks wrong and may be right, in words."""
    zero: Zero
    """The arm at zero."""


class CircleAxis(Record):
    """What an axis rests on: its rows, its arc (or stroke), the widest radius, and how well direction and place are known."""

    arc_deg: float | None
    """Arc the joint moved over, degrees; None for a prismatic joint."""
    joint: str
    """Name of the joint."""
    kind: str
    """Whether the joint is revolute or prismatic."""
    radius_mm: float | None
    """Radius of the widest circle, mm; None for a prismatic joint."""
    rms_mm: float
    """Rms distance of the points from the circle or line, mm."""
    rows: int
    """Rows in which only this joint moved."""
    sigma_deg: float
    """Standard deviation of the direction, degrees."""
    sigma_mm: float
    """Standard deviation of the place, mm."""
    stroke_mm: float | None
    """Stroke the joint moved over, mm; None for a revolute joint."""


class FoundRobot(Record):
    """A robot document to add, its axes, and how far the whole is from the rows."""

    axes: Records[CircleAxis]
    """What each axis rests on, from base to tool."""
    rms_mm: float
    """Rms distance of the rows from what the robot predicts, mm."""
    robot: Mapping[str, Any]
    """The document, ready to be added."""


class OffPoint(Record):
    """How far a point is from where the frame has it."""

    left_mm: float
    """Distance between the point as measured and as the frame has it, mm."""
    name: str
    """Name of the point."""


class Frame(Record):
    """The frame's pose in the device's coordinates, as `base` of a robot that stands on it; and how well the points fit."""

    points: Records[OffPoint]
    """The distance of each point."""
    pose: Pose
    """The frame in the device's coordinates."""
    rms_mm: float
    """Rms distance of the points from where the frame has them, mm."""


class Mesh(Record):
    """The shape of a link. It is drawn only: no load and no identification uses it."""

    created_at: str
    """When it was stored."""
    format: str
    """Format of the file."""
    link: str
    """Name of the joint that moves the link, or `base`."""
    robot: str
    """Name of the robot."""
    sha256: str
    """SHA-256 of the file, 64 hexadecimal digits."""
    triangles: int
    """Number of triangles."""
    unit: str
    """Unit of the coordinates of the file: mm or m."""
