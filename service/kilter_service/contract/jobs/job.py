"""A job: what is asked, how far it is, what came out. Options and result depend on the kind."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from kilter_service.contract.jobs.drift import DriftOptions, DriftResult
from kilter_service.contract.jobs.evaluate import EvaluateOptions, EvaluateResult
from kilter_service.contract.jobs.gap import GapOptions, GapResult
from kilter_service.contract.jobs.identify import IdentifyOptions, IdentifyResult
from kilter_service.contract.jobs.joint_parameters import JointParametersOptions, JointParametersResult
from kilter_service.contract.jobs.plan import PlanOptions, PlanResult
from kilter_service.contract.jobs.rezero import RezeroOptions, RezeroResult
from kilter_service.contract.references import Title
from kilter_service.contract.units import Fraction, Id, Ids, Listed, Strict

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
FINAL: frozenset[str] = frozenset({"succeeded", "failed", "cancelled"})
OPTIONS = "Options of the kind; left out: their defaults."
KIND = "Kind of the job."
RESULT = "What came out; null: it has not succeeded."
NAME = "What people call the job and the version it makes, at most 200 characters; empty: it has no name."


class Folds(Strict):
    """Cross-validation."""

    folds: Annotated[int, Field(ge=2, le=1000)] = Field(
        description="Parts that are held out one after the other, 2 to 1000."
    )


class _NewJob(Strict):
    robot: Id = Field(description="Name of the robot.")
    name: Title = Field("", description=NAME)
    campaigns: Ids = Field([], description="Ids of the campaigns to use, all of that robot; at most 1000.")
    validation: Ids | Fraction | Folds | None = Field(
        None, description="What is held out: campaigns, a fraction of the poses (0 to 1), or folds."
    )
    confirmation: Ids = Field(
        [],
        description="Ids of campaigns of another day or set-up in which what was found must be seen again; kind `gap`.",
    )

    @model_validator(mode="before")
    @classmethod
    def _confirmation_among_options(cls, given: Any) -> Any:
        """Take `options.confirmation` for the field of the same name."""
        options = given.get("options") if isinstance(given, dict) else None
        if not isinstance(options, dict) or "confirmation" not in options:
            return given
        if given.get("confirmation"):
            raise ValueError("confirmation is given twice: leave it out of the options")
        rest = {name: value for name, value in options.items() if name != "confirmation"}
        return {**given, "options": rest, "confirmation": options["confirmation"] or []}


class NewIdentifyJob(_NewJob):
    """Identify parameters from campaigns; the result is a new version."""

    kind: Literal["identify"] = Field(description=KIND)
    options: IdentifyOptions = Field(IdentifyOptions(), description=OPTIONS)


class NewGapJob(_NewJob):
    """Find where the model is wrong and name what is missing; the result is a new version."""

    kind: Literal["gap"] = Field(description=KIND)
    options: GapOptions = Field(GapOptions(), description=OPTIONS)


class NewEvaluateJob(_NewJob):
    """Compare a version with campaigns."""

    kind: Literal["evaluate"] = Field(description=KIND)
    options: EvaluateOptions = Field(EvaluateOptions(), description=OPTIONS)


class NewPlanJob(_NewJob):
    """Plan poses to measure; needs no campaign."""

    kind: Literal["plan"] = Field(description=KIND)
    options: PlanOptions = Field(description="Options of the kind; `purpose` is needed.")


class NewJointParametersJob(_NewJob):
    """Measure joints by inclinometer readings or link-side encoders, or propose where to read."""

    kind: Literal["joint_parameters"] = Field(description=KIND)
    options: JointParametersOptions = Field(JointParametersOptions(), description=OPTIONS)


class NewDriftJob(_NewJob):
    """Check whether an arm has moved since its version was made; names one campaign."""

    kind: Literal["drift"] = Field(description=KIND)
    options: DriftOptions = Field(DriftOptions(), description=OPTIONS)


class NewRezeroJob(_NewJob):
    """Make a version of the one or few parameters that moved; names one campaign."""

    kind: Literal["rezero"] = Field(description=KIND)
    options: RezeroOptions = Field(RezeroOptions(), description=OPTIONS)


NewJob = Annotated[
    NewIdentifyJob | NewGapJob | NewEvaluateJob | NewPlanJob | NewJointParametersJob | NewDriftJob | NewRezeroJob,
    Field(discriminator="kind"),
]


class Progress(Strict):
    """How far a job is (0 to 1) and what it does."""

    fraction: float = Field(description="How far it is, 0 to 1.")
    stage: str = Field(description="What it does now, in words.")


class JobError(Strict):
    """Why a job failed."""

    code: str = Field(description="Stable name of the error.")
    message: str = Field(description="What is wrong, and what helps.")


class JobSummary(Strict):
    """A job in a list."""

    id: str = Field(description="Id of the job, `job_` and 16 hexadecimal digits.")
    kind: str = Field(description=KIND)
    robot: str = Field(description="Name of the robot.")
    name: str = Field("", description=NAME)
    state: State = Field(description="`queued` and `running` become one of the other three.")
    progress: Progress = Field(description="How far it is.")
    error: JobError | None = Field(description="Why it failed; null: it did not.")
    asked_by: str = Field(
        "", description="Who asked for it: name of the token; empty: not noted by an earlier release."
    )
    created_at: datetime = Field(description="When it was asked for.")
    started_at: datetime | None = Field(description="When it began; null: not yet.")
    finished_at: datetime | None = Field(description="When it was over; null: not yet.")


class _Job(JobSummary):
    campaigns: list[str] = Field(description="Ids of the campaigns it uses.")
    validation: list[str] | Fraction | Folds | None = Field(description="What it holds out, as asked.")
    confirmation: list[str] = Field([], description="Campaigns in which what it finds must be seen again.")
    attempts: int = Field(description="How often a worker began it.")


class IdentifyJob(_Job):
    """An identification with what was asked and what came out."""

    kind: Literal["identify"] = Field(description=KIND)
    options: IdentifyOptions = Field(description="Options, as asked.")
    result: IdentifyResult | None = Field(description=RESULT)


class GapJob(_Job):
    """A gap search with its options and its result."""

    kind: Literal["gap"] = Field(description=KIND)
    options: GapOptions = Field(description="Options, as asked.")
    result: GapResult | None = Field(description=RESULT)


class EvaluateJob(_Job):
    """An evaluation with what was asked and what came out."""

    kind: Literal["evaluate"] = Field(description=KIND)
    options: EvaluateOptions = Field(description="Options, as asked.")
    result: EvaluateResult | None = Field(description=RESULT)


class PlanJob(_Job):
    """A plan of poses with what was asked and what came out."""

    kind: Literal["plan"] = Field(description=KIND)
    options: PlanOptions = Field(description="Options, as asked.")
    result: PlanResult | None = Field(description=RESULT)


class JointParametersJob(_Job):
    """A measurement of joints with what was asked and what came out."""

    kind: Literal["joint_parameters"] = Field(description=KIND)
    options: JointParametersOptions = Field(description="Options, as asked.")
    result: JointParametersResult | None = Field(description=RESULT)


class DriftJob(_Job):
    """A check of an arm with what was asked and what came out."""

    kind: Literal["drift"] = Field(description=KIND)
    options: DriftOptions = Field(description="Options, as asked.")
    result: DriftResult | None = Field(description=RESULT)


class RezeroJob(_Job):
    """A re-zeroing with what was asked and what came out."""

    kind: Literal["rezero"] = Field(description=KIND)
    options: RezeroOptions = Field(description="Options, as asked.")
    result: RezeroResult | None = Field(description=RESULT)


Job = Annotated[
    IdentifyJob | GapJob | EvaluateJob | PlanJob | JointParametersJob | DriftJob | RezeroJob,
    Field(discriminator="kind"),
]


class JobList(Listed):
    """Jobs, newest first."""

    jobs: list[JobSummary] = Field(description="Jobs, newest first.")
