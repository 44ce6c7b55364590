"""What a job would do, before it is queued: what it uses, what the data can tell, what is missing, how long it takes.

What the options and results of several kinds of job share.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PlainSerializer

from kilter_service.contract.effects import AnyEffect
from kilter_service.contract.fits import NullDirection
from kilter_service.contract.gap_details import Detectable, Untestable
from kilter_service.contract.units import Id, Mm, Seconds, Stored, Strict
from kilter_service.contract.versions import CorrectionLimits, Objection
from kilter_service.contract.wording import Remark

KIND = "Kind of the job."


class CheckedCampaign(Strict):
    """A campaign that a job would use."""

    id: str = Field(description="Id of the campaign.")
    name: str = Field(description="Name of the campaign.")
    role: str = Field(description="What it was measured for: `train`, `validation` or `confirmation`.")
    use: Literal["train", "validation", "confirmation"] = Field(description="What this job takes it for.")
    device: str = Field(description="What it was measured with.")
    rows: int = Field(description="Rows it has.")
    poses: int | None = Field(description="Distinct poses among the rows; null: it cannot be read.")


class HeldOut(Strict):
    """What a job would not fit, but judge by."""

    how: Literal["campaigns", "fraction", "folds", "unasked", "none"] = Field(
        description="`campaigns` named; a `fraction` of the poses; `folds`, every pose once; `unasked`: the quarter that a "
        "gap search holds out by itself; `none`."
    )
    rows: int = Field(description="Rows held out.")
    poses: int = Field(description="Distinct poses among them.")


class JobProblem(Strict):
    """Why the job would fail."""

    code: str = Field(description="Stable name of the error that the job would end with.")
    message: str = Field(description="What is wrong, and what helps.")


class Missing(Strict):
    """What the job would run without, and what that costs."""

    what: str = Field(description="What is missing, or not seen.")
    reason: str = Field(description="Why it cannot be determined.")
    remedy: str = Field(description="What to measure or to give.")


class Duration(Strict):
    """How long the job would compute, in seconds, without waiting for other jobs."""

    expected: Seconds = Field(description="Most likely, s.")
    low: Seconds = Field(description="Hardly less, s.")
    high: Seconds = Field(description="Hardly more, s.")
    basis: str = Field(
        description="What this rests on: earlier jobs of this server, the job's own beginning, timed here, or a rule."
    )


class UnknownParameter(Strict):
    """A parameter that the poses do not tell."""

    name: str = Field(description="Name of the parameter.")
    reason: str = Field(description="Why, in words.")
    remedy: str = Field(description="What would tell it; tried on the model, under these conditions.")


class Identifiability(Strict):
    """What the poses tell of the parameters, by the Jacobian at the start of the fit."""

    parameters: int = Field(description="How many parameters would be identified.")
    rank: int = Field(description="How many independent combinations of them the poses see at all.")
    identifiable: list[str] = Field(description="Names of the parameters that the poses tell.")
    not_identifiable: list[UnknownParameter] = Field(description="The others, with what would tell them.")
    null_directions: list[NullDirection] = Field(description="Combinations that the poses cannot tell.")
    noise_mm: Mm = Field(description="Standard deviation of a coordinate this was judged with, mm.")
    noise_from: Literal["stated", "repeats", "assumed"] = Field(
        description="Where it comes from: `noise_mm`, repeats of poses, or `assumed` without either."
    )


class Testability(Strict):
    """What a gap search could test, judged with the geometry fitted and nothing named."""

    testable: list[Detectable] = Field(description="Parameters that can be tested, with the smallest amplitude seen.")
    not_testable: list[Untestable] = Field(description="Effects that cannot be tested, with what would help.")


class JobCheck(Strict):
    """What every kind of job would do."""

    robot: str = Field(description="Name of the robot.")
    version: str | None = Field(description="Id of the version it would start from; null: the nominal robot.")
    would_run: bool = Field(description="Whether the job would run through, as far as can be predicted.")
    problems: list[JobProblem] = Field(description="Why it would fail; empty if it would run.")
    campaigns: list[CheckedCampaign] = Field(description="Campaigns it would use, in the order given.")
    rows: int = Field(description="Rows of the campaigns it would learn from, held-out rows among them.")
    poses: int = Field(description="Distinct poses among those rows.")
    held_out: HeldOut = Field(description="What would be held out.")
    missing: list[Missing] = Field(description="What it would run without.")
    limited: list[str] = Field(description="Where this check looked at less than the job would, in words.")
    duration_s: Duration = Field(description="How long it would compute, s.")
    kind: str = Field(description=KIND)


class IdentifiabilityCheck(JobCheck):
    """A check that also says what the poses tell."""

    identifiability: Identifiability | None = Field(
        description="What the poses tell of the parameters; null: see `problems`."
    )


class TestabilityCheck(JobCheck):
    """A check that also says what could be tested."""

    testability: Testability | None = Field(description="What could be tested; null: see `problems`.")


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
