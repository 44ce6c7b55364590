"""What a kind of job is to everybody who asks for one: its declaration, and the models of the contract made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, Literal, TypeGuard, cast

from pydantic import Field, create_model

from kilter_service.contract.jobs.check import JobCheck
from kilter_service.contract.jobs.job import KIND, OPTIONS, RESULT, JobOf, NewJobOf, OptionsT, ResultT

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
