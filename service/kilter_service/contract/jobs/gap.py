"""Jobs of kind ``gap``: where the model is wrong, what is missing, and how sure that is."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field

from kilter_service.contract.columns import WithCoreOptions, with_core_options
from kilter_service.contract.figures import EffectCurve, GapFigures, NextPose, ToldApart
from kilter_service.contract.fits import SEARCHED_MASSES, LoadNumber, NullDirection, PriorUsed, Reference, SetAside
from kilter_service.contract.gap_details import (
    Adequacy,
    AliasMatrix,
    Detectable,
    GapKind,
    GapNoise,
    GapSize,
    MotionFound,
    NamedEffect,
    NegativeControl,
    Place,
    Predictive,
    Refused,
    Untestable,
)
from kilter_service.contract.headlines import (
    HEADLINE,
    Found,
    describe_masses,
    describe_motion,
    describe_search,
    list_found,
)
from kilter_service.contract.jobs.check import (
    FIX,
    FREE,
    LIMITS,
    MASSES_FROM,
    PRIOR,
    Effects,
    Limits,
    MadeVersion,
    MassesFrom,
    Names,
    PriorName,
    TestabilityCheck,
    Version,
)
from kilter_service.contract.jobs.kind import JobContract, JobOf


@with_core_options("gap")
class GapOptions(WithCoreOptions):
    """What can be asked of a gap search."""

    start: Version = Field(None, description="Id of the version to continue from; null: the nominal robot.")
    effects: Effects = Field([], description="Look for these effects only, by id or at some joints; empty: for all.")
    free: Names = Field([], description=FREE)
    fix: Names = Field([], description=FIX)
    refit: Annotated[list[Literal["tool"]], Field(max_length=1)] = Field(
        [],
        description='["tool"]: every campaign and session has a tool of its own (a remounted marker); '
        "[]: all rows share one.",
    )
    masses_from: MassesFrom = Field(None, description=MASSES_FROM)
    prior: PriorName = Field(None, description=PRIOR)
    limits: Limits = Field(None, description=LIMITS)


class GapResult(MadeVersion):
    """What a gap search found. The version holds the named effects and the geometry fitted with them."""

    headline: str | None = Field(None, description=HEADLINE)
    found: list[Found] | None = Field(None, description="What was found, a row for each effect, the surest first.")
    verdict: str | None = Field(
        None,
        description="`no_gap`, `closed`, `provisional`, `unexplained`, or `not_known`: no noise is known apart from the fit.",
    )
    sentence: str | None = Field(None, description="The verdict in words.")
    effects: list[NamedEffect] | None = Field(None, description="Effects that were named.")
    where: list[Place] | None = Field(None, description="Where the model was wrong before.")
    gap: GapSize | None = Field(None, description="How large the gap was and is, on rows fitted and held out.")
    motion: MotionFound | None = Field(None, description="What torques say, of logs of joint torques; null: of poses.")
    measurements: list[GapKind] | None = Field(
        None, description="Noise and errors, before and after, of each kind of measurement."
    )
    predictive: Predictive | None = Field(None, description="How the held-out rows lie in their 95 % intervals.")
    adequacy: Adequacy | None = Field(None, description="Whether the model now agrees with the rows.")
    noise: GapNoise | None = Field(None, description="The noise that the gap is compared with.")
    not_testable: list[Untestable] | None = Field(None, description="What these rows cannot say, and how they could.")
    smallest_detectable: list[Detectable] | None = Field(None, description="Smallest amplitude that would be seen.")
    refused: list[Refused] | None = Field(None, description="What was tested and not named, with its score.")
    next_poses: list[NextPose] | None = Field(None, description="Poses to measure next.")
    told_apart: ToldApart | None = Field(
        None, description="Whether they tell two effects apart; null: they make one surer, or there are none."
    )
    next_poses_csv: str | None = Field(None, description="The same as a CSV file of columns of a measurement.")
    negative_control: NegativeControl | None = Field(None, description="What shuffled rows would name.")
    alias_matrix: AliasMatrix | None = Field(None, description="How well signatures correlate in these rows.")
    figures: GapFigures | None = Field(None, description="Figures by name.")
    effect_curves: list[EffectCurve] | None = Field(
        None,
        description="Each named effect that moves a joint, over the quantity that it follows; null: earlier results.",
    )
    set_aside: list[SetAside] | None = Field(None, description="Rows that the search set aside, held out or not.")
    load_model: list[LoadNumber] | None = Field(None, description="Masses and centres as stated and as found.")
    masses_from: str | None = Field(None, description=SEARCHED_MASSES)
    null_directions: list[NullDirection] | None = Field(
        None,
        description="What these data cannot tell apart in the final model, and sums that they know; null: earlier results.",
    )
    reference: Reference | None = Field(None, description="Where the frames of a correction come from.")
    prior: PriorUsed | None = Field(None, description="What other robots of the type said; null: they were not asked.")
    start: str | None = Field(None, description="The version it continued from; null: the nominal robot.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline, to results of earlier releases too."""
        if self.verdict is not None:
            effects = self.effects or []
            self.headline = (
                describe_motion(effects, self.motion)
                if self.motion is not None
                else describe_search(
                    self.verdict, effects, self.gap, self.adequacy, self.noise, self.next_poses or [], self.told_apart
                )
                + describe_masses(self.masses_from)
            )
            self.found = list_found(effects)


GAP = JobContract(
    "gap",
    noun="gap search",
    title="Search for what is missing",
    summary="Find where the model is wrong and name what is missing; the result is a new version.",
    options=GapOptions,
    result=GapResult,
    seconds=(5.0, 2.0, 60.0),
    version_option="start",
    takes_confirmation=True,
    long=True,
    usual=("effects", "start", "noise_mm", "alpha"),
    uses={"train": "train", "validation": "validation", "confirmation": "confirmation"},
    check=TestabilityCheck,
)
GapJob: TypeAlias = JobOf[GapOptions, GapResult]
