"""Jobs of kind ``joint_parameters``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from service.contract.units import Strict

RESOLUTION_DEG = 0.001


class Reading(Strict):
    """One reading: what the joint turned about an axis of its frame beyond the command, up to a constant per series."""

    joint: str
    axis: Literal["x", "y", "z"]
    q_deg: list[FiniteFloat]
    reading_deg: FiniteFloat
    payload_kg: Annotated[float, Field(ge=0)] = 0.0
    series: int = 0


class Options(Strict):
    """Readings to evaluate, or a joint to propose configurations for. ``q_deg`` of a slide is in mm."""

    readings: list[Reading] = []
    resolution_deg: Annotated[float, Field(gt=0)] = RESOLUTION_DEG
    propose: str | None = None
    count: Annotated[int, Field(ge=4, le=200)] = 8
    payloads_kg: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)] = [0.0]
    seed: Annotated[int, Field(ge=0)] = 0
