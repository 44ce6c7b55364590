"""What Kilter says of robots: lists, reports, the check of a document, and a robot found from circles."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field, model_validator

from service.contract.references import RetiredAt
from service.contract.robots import RobotDocument
from service.contract.units import JointType, Pose, Strict

Triple = tuple[float, float, float]


class JointSummary(Strict):
    """A joint as Kilter understood it."""

    name: str
    kind: JointType
    limits_deg: tuple[float | None, float | None] | None = None
    limits_mm: tuple[float | None, float | None] | None = None
    gear_ratio: float | None = None

    @model_validator(mode="after")
    def _one_unit(self) -> JointSummary:
        assert (self.limits_deg is None) != (self.limits_mm is None)
        return self


class RobotSummary(Strict):
    """A robot in a list."""

    name: str
    convention: str
    created_at: datetime
    campaigns: int
    versions: int
    active_version: str | None
    remarks: Annotated[str, Field(description="What people noted on the robot")] = ""
    retired_at: RetiredAt = None


class RobotReport(RobotSummary):
    """A robot with its joints, the names of its geometric parameters, and the document it was posted as."""

    joints: list[JointSummary]
    parameters: list[str]
    notes: list[str]
    sha256: Annotated[
        str, Field(description="SHA-256 of the chain that the document was resolved to when it was posted")
    ]
    source_sha256: Annotated[str, Field(description="SHA-256 of the posted document, of a URDF that of its text")]
    document: RobotDocument


class RobotList(Strict):
    """All robots, by name."""

    robots: list[RobotSummary]


class AxisReport(Strict):
    """An axis at zero, in the frame the base stands in; a joint that drives several axes has several."""

    joint: str
    kind: JointType
    ratio: float
    point_mm: Triple
    direction: Triple
    angle_to_previous_deg: float | None
    distance_to_previous_mm: float | None


class Zero(Strict):
    """The arm at zero: base, a point on each axis, flange and tool point; and the tool's pose."""

    points_mm: list[Triple]
    tool: Pose


class RobotCheck(Strict):
    """What a robot document comes to; ``suspicious`` is what looks wrong and may be right."""

    name: str
    joints: list[JointSummary]
    axes: list[AxisReport]
    zero: Zero
    reach_mm: float
    suspicious: list[str]
    notes: list[str]


class CircleAxis(Strict):
    """What an axis rests on: its rows, its arc (or stroke), the widest radius, and how well direction and place are known."""

    joint: str
    kind: JointType
    rows: int
    arc_deg: float | None
    stroke_mm: float | None
    radius_mm: float | None
    rms_mm: float
    sigma_deg: float
    sigma_mm: float


class FoundRobot(Strict):
    """A robot document to add, its axes, and how far the whole is from the rows."""

    robot: RobotDocument
    axes: list[CircleAxis]
    rms_mm: float
