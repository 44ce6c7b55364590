"""Jobs of kind ``identify``: observations into a new parameter version."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field

from kilter_service.contract.columns import WithCoreOptions, with_core_options
from kilter_service.contract.figures import IdentifyFigures
from kilter_service.contract.fits import FitDetails, Metrics, NullDirection, Parameter
from kilter_service.contract.gap_details import MotionFound, NamedEffect, Untestable
from kilter_service.contract.headlines import (
    HEADLINE,
    Found,
    describe_fit,
    describe_masses,
    describe_motion,
    list_found,
)
from kilter_service.contract.jobs.check import (
    FIX,
    FREE,
    LIMITS,
    MASSES_FROM,
    START,
    Effects,
    IdentifiabilityCheck,
    Limits,
    MadeVersion,
    MassesFrom,
    Names,
    Version,
)
from kilter_service.contract.jobs.kind import JobContract, JobOf
from kilter_service.contract.units import Mm


@with_core_options("identify")
class IdentifyOptions(WithCoreOptions):
    """What can be asked of an identification."""

    effects: Effects = Field(
        [], description="Effects to identify, by id or with options; empty: none, at level 3 the thesis's three."
    )
    free: Names = Field([], description=FREE)
    fix: Names = Field([], description=FIX)
    refit: Annotated[list[Literal["base", "tool"]], Field(max_length=2)] | None = Field(
        None,
        description='["base"]: every campaign and session has a base of its own; ["tool"]: a tool (a remounted marker); '
        "[]: all rows share one of each; null: the device decides, and sheets and ball bars have bases of their own.",
    )
    sheet_order: Literal["checked", "given"] | None = Field(
        None,
        description="`given`: the quarter points of drawn sheets are in the right order, do not check; null: `checked`.",
    )
    start: Version = Field(None, description=START)
    masses_from: MassesFrom = Field(None, description=MASSES_FROM)
    limits: Limits = Field(None, description=LIMITS)
    socket_distances_mm: dict[
        Annotated[str, Field(pattern=r"^[0-9]+-[0-9]+$", max_length=32)], Annotated[Mm, Field(gt=0)]
    ] = Field({}, description='Known distances between ball sockets, mm, above 0: {"1-2": 400.0}.')


class IdentifyResult(FitDetails, MadeVersion):
    """What an identification found; the version holds the same."""

    headline: str | None = Field(None, description=HEADLINE)
    parameters: list[Parameter] | None = Field(None, description="Parameters that were identified.")
    null_directions: list[NullDirection] | None = Field(None, description="What the data could not tell.")
    metrics: Metrics | None = Field(None, description="Errors on the rows fitted and on those held out.")
    noise_mm: Mm | None = Field(None, description="Standard deviation of a coordinate of the noise, mm.")
    figures: IdentifyFigures | None = Field(None, description="Figures by name.")
    motion: MotionFound | None = Field(None, description="What torques say, of logs of joint torques; null: of poses.")
    effects: list[NamedEffect] | None = Field(None, description="Of logs of torques: the effects that were asked for.")
    found: list[Found] | None = Field(None, description="The same in words, a row for each, the surest first.")
    not_testable: list[Untestable] | None = Field(None, description="Of logs of torques: what they cannot say.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline, to results of earlier releases too."""
        if self.motion is not None:
            self.headline, self.found = describe_motion(self.effects or [], self.motion), list_found(self.effects or [])
        if self.metrics is not None:
            said = describe_fit(self.metrics, self.parameters or [], self.noise_mm, self.noise, self.pixels)
            self.headline = said + describe_masses(self.masses_from)


IDENTIFY = JobContract(
    "identify",
    noun="identification",
    title="Identify parameters",
    summary="Identify parameters from campaigns; the result is a new version.",
    options=IdentifyOptions,
    result=IdentifyResult,
    seconds=(1.0, 0.3, 20.0),
    version_option="start",
    takes_folds=True,
    usual=("method", "level", "effects", "loss", "start"),
    uses={"train": "train", "validation": "validation"},
    check=IdentifiabilityCheck,
)
IdentifyJob: TypeAlias = JobOf[IdentifyOptions, IdentifyResult]
