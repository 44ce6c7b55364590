"""What a job would do, before it is queued: what it uses, what the data can tell, what is missing, how long it takes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.fits import NullDirection
from kilter_service.contract.gap_details import Detectable, Untestable
from kilter_service.contract.units import Mm, Seconds, Strict

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
