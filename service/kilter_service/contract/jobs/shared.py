"""What the options and results of several kinds of job share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PlainSerializer

from kilter_service.contract.effects import AnyEffect
from kilter_service.contract.remarks import Remark
from kilter_service.contract.units import Id, Mm, Stored
from kilter_service.contract.versions import CorrectionLimits, Objection

MAX_EFFECTS = 200
Effects = Annotated[list[AnyEffect], Field(max_length=MAX_EFFECTS)]
Names = Annotated[list[Annotated[str, Field(min_length=1, max_length=128)]], Field(max_length=1000)]
Seed = Annotated[int, Field(ge=0, le=2**31)]
NoiseMm = Annotated[Mm, Field(gt=0)]
SetupMm = Annotated[Mm, Field(ge=0)]
Version = Id | None
PriorName = Literal["fleet"] | None
AskedLimits = Annotated[CorrectionLimits, PlainSerializer(lambda limits: limits.model_dump(exclude_unset=True))]
Limits = AskedLimits | None


def _base_first(frames: list[str]) -> list[str]:
    if frames == ["tool"]:
        raise ValueError("give base, or base and tool, or leave it out")
    return frames


NewFrames = Annotated[list[Literal["base", "tool"]], Field(max_length=2), AfterValidator(_base_first)]

FREE = "Parameters to identify, by name or pattern (`alpha_*`); empty: those of the level."
FIX = "Parameters to hold, by name or pattern (`alpha_*`)."
START = "Id of the version to start from; null: the nominal robot."
LIMITS = (
    "The largest correction the version may make; null: what it needs at 99 % of its poses, from 1 degree and 5 mm to "
    "5 degrees and 10 mm."
)
NEWEST = "newest"
MassesFrom = Annotated[str, Field(max_length=64)] | None
MASSES_FROM = (
    "Id of a search in torques of this robot, or `newest`: masses and centres of links, and friction of joints, are what it "
    "found, as surely as it knows them; null: as the robot is described."
)
PRIOR = (
    "`fleet`: add what versions of at least five other robots of this type say before the rows; null: none of them is "
    "asked."
)


class MadeVersion(Stored):
    """What a job says of the version it made."""

    version_id: str | None = Field(None, description="Id of the version it made; null: none.")
    objections: list[Objection] | None = Field(None, description="What it found against activating the version.")
    warnings: list[Remark] | None = Field(None, description="What to know before trusting the result.")
