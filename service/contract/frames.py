"""Frames from digitised points."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from service.contract.units import Pose, Strict, Vector


class KnownPoint(Strict):
    """A point whose place in the frame is known, as the device measured it."""

    name: Annotated[str, Field(max_length=64)] = ""
    known_mm: Vector
    measured_mm: Vector


class Features(Strict):
    """Points on the frame's xy plane, along its x axis (first to last), and one above or below its origin."""

    plane_mm: Annotated[list[Vector], Field(min_length=3, max_length=10_000)]
    line_mm: Annotated[list[Vector], Field(min_length=2, max_length=10_000)]
    origin_mm: Vector


class NewFrame(Strict):
    """Known points, or features: one of them."""

    points: Annotated[list[KnownPoint], Field(min_length=1, max_length=10_000)] | None = None
    features: Features | None = None


class OffPoint(Strict):
    """How far a point is from where the frame has it."""

    name: str
    left_mm: float


class Frame(Strict):
    """The frame's pose in the device's coordinates, as `base` of a robot that stands on it; and how well the points fit."""

    pose: Pose
    rms_mm: float
    points: list[OffPoint]
