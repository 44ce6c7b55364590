"""A job: what is asked, how far it is, what came out."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from service.contract.references import Title
from service.contract.units import Fraction, Id, Ids, Strict

State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
FINAL: frozenset[str] = frozenset({"succeeded", "failed", "cancelled"})


class Folds(Strict):
    """Cross-validation."""

    folds: Annotated[int, Field(ge=2, le=1000)]


class NewJob(Strict):
    """A job to run. Which options there are depends on the kind.

    Campaigns of `confirmation` are measured on another day or set-up: what was found must be seen there again.
    """

    kind: Id
    robot: Id
    name: Annotated[Title, Field(description="What people call the job, and the version that it makes")] = ""
    campaigns: Ids = []
    validation: Ids | Fraction | Folds | None = None
    confirmation: Ids = []
    options: dict[str, Any] = {}

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


class Progress(Strict):
    """How far a job is (0 to 1) and what it does."""

    fraction: float
    stage: str


class JobError(Strict):
    """Why a job failed."""

    code: str
    message: str


class JobSummary(Strict):
    """A job in a list."""

    id: str
    kind: str
    robot: str
    name: Title = ""
    state: State
    progress: Progress
    error: JobError | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


class Job(JobSummary):
    """A job with what was asked and what came out; ``result.version_id`` names the version it made."""

    campaigns: list[str]
    validation: list[str] | Fraction | Folds | None
    confirmation: list[str] = []
    options: dict[str, Any]
    attempts: int
    result: dict[str, Any] | None


class JobList(Strict):
    """Jobs, newest first."""

    jobs: list[JobSummary]
