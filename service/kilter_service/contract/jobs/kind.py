"""What a kind of job is to everybody who asks for one: its declaration, and the models of the contract made from it.

A job: what is asked, how far it is, what came out. Options and result are those of its kind (``kind.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from typing import Annotated, Any, Generic, Literal, TypeGuard, TypeVar, cast

from pydantic import BaseModel, Field, create_model, model_validator

from kilter_service.contract.jobs.check import JobCheck
from kilter_service.contract.units import Asked, Fraction, Id, Ids, Listed, Strict
from kilter_service.contract.wording import Title

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


Use = Literal["train", "validation", "confirmation"]


@dataclass(frozen=True)
class JobContract(Generic[OptionsT, ResultT]):
    """The declaration of a kind of job, beside its options and its result.

    ``noun`` is what such a job is in a sentence ("an identification"), ``title`` what the page names it, and ``summary``
    what it does. ``seconds`` are those of a job of some hundred poses on a machine of 2024: expected, low, high.

    ``version_option`` names the option that holds a version; ``needs_campaigns``, ``takes_folds`` and
    ``takes_confirmation`` say what a request must and may have, ``instead_of_campaigns`` which options replace campaigns,
    ``most_campaigns`` how many it may name. ``long`` kinds have a queue of their own: whoever identifies does not wait for
    somebody's gap search. ``history`` kinds want to know where the arm was driven before, ``against_fit`` kinds what their
    version was fitted to.

    The page's form shows the options ``usual`` first and presets campaigns of each role for the use that ``uses`` names;
    the result of a ``watching`` kind stands beside the other checks of the robot. ``check`` is the model of what a
    preview of such a job says.
    """

    name: str
    noun: str
    title: str
    summary: str
    options: type[OptionsT]
    result: type[ResultT]
    seconds: tuple[float, float, float] = (5.0, 0.5, 120.0)
    version_option: str | None = None
    needs_campaigns: bool = True
    takes_folds: bool = False
    takes_confirmation: bool = False
    instead_of_campaigns: tuple[str, ...] = ()
    most_campaigns: int | None = None
    long: bool = False
    history: bool = False
    against_fit: bool = False
    watching: bool = False
    usual: tuple[str, ...] = ()
    uses: Mapping[str, Use] = field(default_factory=dict)
    check: type[JobCheck] = JobCheck

    @cached_property
    def request(self) -> type[NewJobOf[OptionsT]]:
        """Model of the request for such a job; options may be left out where none must be given."""
        needed = [f"`{name}`" for name, one in self.options.model_fields.items() if one.is_required()]
        text = f"Options of the kind; {', '.join(needed)} is needed." if needed else OPTIONS
        options: Any = Field(... if needed else self.options(), description=text)
        base: Any = NewJobOf[self.options]  # type: ignore[name-defined]
        return cast(
            "type[NewJobOf[OptionsT]]",
            self._model(f"New{self._stem}Job", base, self.summary, options=(self.options, options)),
        )

    @cached_property
    def job(self) -> type[JobOf[OptionsT, ResultT]]:
        """Model of such a job with what was asked and what came out."""
        text = f"{self._indefinite[0].upper()}{self._indefinite[1:]} with what was asked and what came out."
        result = (self.result | None, Field(description=RESULT))
        base: Any = JobOf[self.options, self.result]  # type: ignore[name-defined]
        return cast("type[JobOf[OptionsT, ResultT]]", self._model(f"{self._stem}Job", base, text, result=result))

    @cached_property
    def preview(self) -> type[JobCheck]:
        """Model of what such a job would do."""
        text = f"What {self._indefinite} would do."
        return cast("type[JobCheck]", self._model(f"{self._stem}Check", self.check, text))

    def is_kind_of(self, job: JobOf[Any, Any]) -> TypeGuard[JobOf[OptionsT, ResultT]]:
        """Whether a job is of this kind."""
        return job.kind == self.name

    @property
    def _stem(self) -> str:
        return self.options.__name__.removesuffix("Options")

    @property
    def _indefinite(self) -> str:
        return f"{'an' if self.noun[0] in 'aeiou' else 'a'} {self.noun}"

    def _model(self, name: str, base: Any, text: str, **fields: Any) -> Any:
        kind: Any = (Literal[self.name], Field(description=KIND))
        return create_model(name, __base__=base, __module__=__name__, __doc__=text, kind=kind, **fields)
