"""A job: what is asked, how far it is, what came out. Options and result are those of its kind (``kind.py``)."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, Field, model_validator

from kilter_service.contract.references import Title
from kilter_service.contract.units import Asked, Fraction, Id, Ids, Listed, Strict

OptionsT = TypeVar("OptionsT", bound=Asked)
ResultT = TypeVar("ResultT", bound=BaseModel)

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
FINAL: frozenset[str] = frozenset({"succeeded", "failed", "cancelled"})
OPTIONS = "Options of the kind; left out: their defaults."
KIND = "Kind of the job."
RESULT = "What came out; null: it has not succeeded."
NAME = (
    "What people call the job and the version it makes, at most 200 characters. Empty: the job is called by what it is, its "
    "robot and a number, as in 'gap search of tour 3'."
)


class Folds(Strict):
    """Cross-validation."""

    folds: Annotated[int, Field(ge=2, le=1000)] = Field(
        description="Parts that are held out one after the other, 2 to 1000."
    )


class NewJobOf(Strict, Generic[OptionsT]):
    """What every job is asked for with."""

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
    kind: str = Field(description=KIND)
    options: OptionsT = Field(description=OPTIONS)

    @model_validator(mode="before")
    @classmethod
    def _confirmation_among_options(cls, given: Any) -> Any:
        """Take `options.confirmation` for the field of the same name, and an empty hold-out for none."""
        if isinstance(given, dict) and given.get("validation") == []:
            given = {**given, "validation": None}  # no campaign is held out
        options = given.get("options") if isinstance(given, dict) else None
        if not isinstance(options, dict) or "confirmation" not in options:
            return given
        if given.get("confirmation"):
            raise ValueError("confirmation is given twice: leave it out of the options")
        rest = {name: value for name, value in options.items() if name != "confirmation"}
        return {**given, "options": rest, "confirmation": options["confirmation"] or []}


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


class JobOf(JobSummary, Generic[OptionsT, ResultT]):
    """A job with what was asked and what came out."""

    campaigns: list[str] = Field(description="Ids of the campaigns it uses.")
    validation: list[str] | Fraction | Folds | None = Field(description="What it holds out, as asked.")
    confirmation: list[str] = Field([], description="Campaigns in which what it finds must be seen again.")
    attempts: int = Field(description="How often a worker began it.")
    options: OptionsT = Field(description="Options, as asked.")
    result: ResultT | None = Field(description=RESULT)


class JobList(Listed):
    """Jobs, newest first."""

    jobs: list[JobSummary] = Field(description="Jobs, newest first.")
