"""What versions of other robots of a type said before an arm was measured."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.units import Stored


class FleetVersion(Stored):
    """A version of another robot of the type."""

    robot: str = Field(description="Name of the robot.")
    version: str = Field(description="Id of its version.")
    reason: str | None = Field(None, description="Why a prior does without it; null: it is part of it.")


class LeftOneOut(Stored):
    """A robot as the others of its type predict it."""

    robot: str = Field(description="Name of the robot.")
    chi_square: float | None = Field(None, description="Chi-square of its parameters against the others' prior.")
    compared: int | None = Field(None, description="Parameters that were compared.")
    p_value: float | None = Field(None, description="Chance of as large a chi-square for a robot of the type.")


class PriorUsed(Stored):
    """What other robots of the type said beforehand, and how far this arm was believed to be as they are."""

    source: str | None = Field(None, description="`fleet`: versions of other robots of the type.")
    state: Literal["used", "widened", "dropped"] | None = Field(
        None,
        description="`used` as it is; `widened`, since this arm is odder than most, `odd` in some parameters, or moved by "
        "the type farther than its rows allow; `dropped`, since it is not as its type.",
    )
    widened_by: float | None = Field(None, description="Factor of its standard deviations; null: dropped.")
    limited_by: float | None = Field(
        None,
        description="Part of that factor, so that the type may move the tool by 0.26 of the error that is expected "
        "without it, and no more; 1: none. Null: stored without.",
    )
    chi_square: float | None = Field(None, description="Chi-square of the arm against its type.")
    compared: int | None = Field(None, description="Directions that were compared.")
    p_value: float | None = Field(None, description="Chance of as large a chi-square for a robot of the type.")
    odd: list[str] | None = Field(
        None, description="Parameters in which the arm is not as its type: the rows alone say."
    )
    parameters: list[str] | None = Field(None, description="Parameters that rest on the prior and not on the rows.")
    sentence: str | None = Field(None, description="All of that in words.")
    versions: list[FleetVersion] | None = Field(None, description="The versions it rests on.")
    left_out: list[FleetVersion] | None = Field(None, description="Versions of another gauge, which it does without.")
    left_one_out: list[LeftOneOut] | None = Field(None, description="how well the robots predict each other.")
