"""Poses that a search proposes to measure, and whether they tell two effects apart."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Deg, Kg, PointMm, Stored


class NextPose(Stored):
    """A pose to measure next."""

    kind: str | None = Field(None, description="`new`, or what is done again.")
    change: str | None = Field(None, description="What to change before it, in words; null: nothing.")
    q_deg: list[Deg] | None = Field(None, description="All joints, degrees; mm for prismatic ones.")
    payload_kg: Kg | None = Field(None, description="Load to carry, kg; null: any.")
    payload_com_mm: PointMm | None = Field(None, description="Its centre in the tool frame, mm; null: the tool point.")
    direction: list[int] | None = Field(None, description="Direction to reach each joint from, -1 or 1; null: any.")
    separates: list[str] | None = Field(None, description="The two that it tells apart.")
    information_factor: float | None = Field(
        None, description="How much more is known after it and all before it, as a factor."
    )


class ToldApart(Stored):
    """Whether proposed poses tell two effects apart, and what does where they do not."""

    separates: list[str] | None = Field(None, description="The two in question.")
    poses: int | None = Field(None, description="How many poses are proposed for it.")
    information_factor: float | None = Field(
        None, description="How much more is known after all of them, as a factor; near 1: nothing."
    )
    enough: bool | None = Field(None, description="Whether they tell the two apart, but for one case in a thousand.")
    poses_needed: int | None = Field(None, description="How many such poses would; null: more than 1000.")
    instead: list[str] | None = Field(None, description="What to do instead, in words, the quickest first.")
    sentence: str | None = Field(None, description="All of it in words.")
