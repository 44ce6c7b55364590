"""What a named effect does to a joint, over the quantity that it follows: the numbers of a picture.

Poses that a search proposes to measure, and whether they tell two effects apart.
"""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.gap_details import AtJoints
from kilter_service.contract.units import Deg, Kg, PointMm, Stored


class CurveSide(Stored):
    """A curve over the quantity that an effect follows."""

    direction: float | None = Field(None, description="Direction of the last motion, 1 or -1; null: it does not count.")
    x: list[float] = Field(description="Values of the quantity, in `x_unit`.")
    y: list[float] = Field(description="What the joint rotates or moves by, in `unit`.")
    low: list[float] | None = Field(None, description="Lower end of the 95 % band; null: it has none.")
    high: list[float] | None = Field(None, description="Upper end of the 95 % band; null: it has none.")


class CurveVisits(Stored):
    """What each visit says that an effect does: the curve and what is left, as motion of the joint."""

    x: list[float] = Field(description="Values of the quantity, in `x_unit`.")
    y: list[float] = Field(description="What the visit says, in `unit`.")
    half: list[float] = Field(description="Half of its 95 % interval, in `unit`.")
    curve: list[float] = Field(description="What the curve says there, in `unit`.")
    direction: list[float] | None = Field(None, description="Direction of the last motion; null: it does not count.")
    faint: int = Field(description="Visits that say too little of this joint to be drawn: the tool is near its axis.")
    of: int = Field(description="Visits that the search used.")


class CurveRival(AtJoints):
    """The refused effect that comes nearest to the visits, with a zero of its own."""

    times: float = Field(
        description="Squares that it leaves at the visits, as a multiple of those that the curve leaves."
    )
    sides: list[CurveSide] = Field(description="Its curve, or one for each direction.")


class CurveDistance(Stored):
    """How far the curves of both directions are apart, on average, in `unit`."""

    value: float = Field(description="The one of direction 1 less the one of -1.")
    low: float = Field(description="Lower end of the 95 % interval.")
    high: float = Field(description="Upper end of the 95 % interval.")


class EffectCurve(AtJoints):
    """What a named effect does to one of its joints, over the quantity that it follows; no lever arm is in it."""

    joint: int = Field(description="The joint, from 1.")
    follows: str = Field(
        description="The quantity: `q` (of the joint), `axial` (load about or along it), `t` (from the first visit on) or "
        "`temperature_c`."
    )
    x_unit: str = Field(description="Unit of the quantity.")
    unit: str = Field(description="Unit of what the joint rotates or moves by.")
    sides: list[CurveSide] = Field(description="The curve, or one for each direction of the last motion.")
    visits: CurveVisits = Field(description="What the visits say, at most 400 of them.")
    distance: CurveDistance | None = Field(None, description="How far both directions are apart; null: there is one.")
    rival: CurveRival | None = Field(
        None, description="What was refused; null: nothing that follows the same quantity."
    )


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
