"""Wire types of the check of a robot document."""

from __future__ import annotations

from typing import Literal

from service.robots.schemas import JointSummary, Pose, Strict

Point = tuple[float, float, float]


class AxisReport(Strict):
    """An axis at zero, in the frame the base stands in; a joint that drives several axes has several."""

    joint: str
    kind: Literal["revolute", "prismatic"]
    ratio: float
    point_mm: Point
    direction: Point
    angle_to_previous_deg: float | None
    distance_to_previous_mm: float | None


class Zero(Strict):
    """The arm at zero: base, a point on each axis, flange and tool point; and the tool's pose."""

    points_mm: list[Point]
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
