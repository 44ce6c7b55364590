"""Warnings beside a result."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Deg, Mm, Stored


class OddMass(Stored):
    """A mass or a centre far from what was stated."""

    link: int | None = Field(None, description="Number of the link, from 1; null: the payload.")
    parameter: str | None = Field(None, description="`mass`, or a coordinate of the centre such as `com_x`.")
    unit: str | None = Field(None, description="kg or mm.")
    stated: float | None = Field(None, description="What was stated.")
    value: float | None = Field(None, description="What the data say.")


class Remark(Stored):
    """A warning: ``code`` is for programs, ``message`` says what is the matter and what helps. The rest goes with the code."""

    code: str = Field(description="Stable name of the warning.")
    message: str = Field(description="What is the matter, and what helps.")
    joint: str | None = Field(None, description="Name of the joint it is about.")
    effects: list[str] | None = Field(None, description="Ids of the effects it is about.")
    campaigns: list[str] | None = Field(None, description="Ids of the campaigns it is about.")
    markers: list[int] | None = Field(None, description="Numbers of the markers it is about, from 1.")
    rows: list[int] | None = Field(None, description="Rows it is about, from 1.")
    off_mm: list[Mm] | None = Field(None, description="How far each of these rows is off, mm.")
    others_mm: Mm | None = Field(
        None, description="How far the other rows are off at most, but for a quarter of them, mm."
    )
    sigmas: list[float] | None = Field(
        None, description="The same of its worst coordinate, in standard deviations of what was expected there."
    )
    row: int | None = Field(None, description="The row it is about, from 0.")
    visits: int | None = Field(None, description="How many visits it is about.")
    masses: list[OddMass] | None = Field(None, description="Masses and centres far from what was stated.")
    ratio: float | None = Field(None, description="What is left, in multiples of the noise.")
    axis: str | None = Field(None, description="Axis it is about, such as `z` or `-x`.")
    angle_deg: Deg | None = Field(None, description="Angle it is about, degrees.")
    here_mm: Mm | None = Field(None, description="Uncertainty of the tool in the measured poses, mm.")
    elsewhere_mm: Mm | None = Field(None, description="Uncertainty of the tool over the joint limits, mm.")
    simpler_mm: Mm | None = Field(None, description="Error of the simpler model on held-out rows, mm.")
    identified_mm: Mm | None = Field(None, description="Error of the identified model on held-out rows, mm.")
    left_out: list[str] | None = Field(None, description="What there was no time for.")
    budget_s: float | None = Field(None, description="Time that was given, s.")
    quantity: str | None = Field(None, description="Which errors were compared: `mean by pose` or `rms by pose`.")
    simpler_deg: Deg | None = Field(None, description="Error of the simpler model on held-out rows, degrees.")
    identified_deg: Deg | None = Field(None, description="Error of the identified model on held-out rows, degrees.")
    beyond_chance: bool | None = Field(None, description="Whether the difference is more than chance explains.")
