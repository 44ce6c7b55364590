"""Wire types of robots found from circles."""

from __future__ import annotations

from typing import Literal

from service.robots.schemas import RobotDocument, Strict


class CircleAxis(Strict):
    """What an axis rests on: its rows, its arc (or stroke), the widest radius, and how well direction and place are known."""

    joint: str
    kind: Literal["revolute", "prismatic"]
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
