"""Frames from digitised points."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from kilter_service.contract.units import Mm, PointMm, Pose, Strict


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
