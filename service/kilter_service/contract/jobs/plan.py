"""Jobs of kind ``plan``: poses to measure."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import ConfigDict, Field

from kilter_service.contract.figures import ToldApart
from kilter_service.contract.jobs.check import PRIOR, Effects, NoiseMm, PriorName, Seed, Version
from kilter_service.contract.jobs.drift import SmallestChange
from kilter_service.contract.jobs.kind import JobContract, JobOf
from kilter_service.contract.units import MAX_JOINTS, Asked, JointNumber, Kg, Mm, PointMm, Stored
from kilter_service.contract.wording import Remark

MAX_POSES = 2000
HEAVIEST_KG = 1000.0
Purpose = Literal["iso9283", "identify", "separate", "check"]
Corner = Annotated[PointMm, Field(strict=False)]
Within = Literal["campaigns", "limits"]


class PlanOptions(Asked):
    """What can be asked of a plan."""

    purpose: Purpose = Field(
        description="`iso9283`: cube and planes of the standard; `identify`: poses that determine the parameters best; "
        "`separate`: poses that tell two effects apart; `check`: the few poses that best show whether the arm has moved."
    )
    method: Literal["d_optimal", "views", "iso9283", "five_poses", "two_poses"] = Field(
        "d_optimal",
        description="Of `identify`: `d_optimal`, `views` (the same of what cameras see of boards, which version or campaigns "
        "know) or the poses of `iso9283`; of `iso9283`: `five_poses` or `two_poses` for its cycles.",
    )
    count: Annotated[int, Field(ge=1, le=MAX_POSES)] | None = Field(
        None, description="Poses, 1 to 2000, or cycles; null: 118, 60, 12 or 5 poses by purpose, 30 cycles."
    )
    effects: Effects = Field(
        [],
        description="Of `identify`: effects to see; of `separate`: the two, or one to tell from geometry; empty: what the "
        "gap search that made the version left undecided.",
    )
    seed: Seed = Field(0, description="Seed of the choice, 0 or more.")
    noise_mm: NoiseMm | None = Field(
        None,
        description="Standard deviation of a coordinate, or at the board of a corner that a camera sees, mm, above 0; null: "
        "that of the repeats, else 0.05.",
    )
    version: Version = Field(None, description="Id of the version to plan with; null: the nominal robot.")
    box_mm: Annotated[tuple[Corner, Corner], Field(strict=False)] | None = Field(
        None, description="Lowest and highest corner, mm, of a box the tool stays in, in the frame of the measurements."
    )
    keep_out_mm: Annotated[list[Annotated[tuple[Corner, Corner], Field(strict=False)]], Field(max_length=100)] = Field(
        [],
        description="Lowest and highest corners, mm, of boxes that no line between joints and tool enters, in the frame of "
        "the measurements.",
    )
    without_joints: Annotated[list[JointNumber], Field(max_length=MAX_JOINTS)] = Field(
        [], description="Of `check`: joints, from 1, whose zeros need not be seen."
    )
    floor_mm: Mm | None = Field(
        None, description="Height in the robot's base frame, mm, that no joint and no tool point goes below."
    )
    within: Within = Field(
        "campaigns", description="Where poses may be: where the robot was driven before, or anywhere in its limits."
    )
    prior: PriorName = Field(None, description="Of `identify` by `d_optimal`: " + PRIOR)
    payloads_kg: Annotated[list[Annotated[Kg, Field(ge=0, le=HEAVIEST_KG)]], Field(max_length=100)] = Field(
        [], description="Loads at hand, kg, 0 to 1000; used where an effect feels them."
    )
    payload_com_mm: Corner | None = Field(
        None, description="Centre of these loads in the tool frame, mm; null: the tool point."
    )


class PlannedPose(Stored):
    """A pose to measure; further fields are the joints, as in a measurement: `q1_deg` ..., `q3_mm` of a prismatic joint."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]

    kind: str | None = Field(None, description="`new`, or what is done again.")
    change: str | None = Field(None, description="What to change before it, in words; null: nothing.")
    payload_kg: Kg | None = Field(None, description="Load to carry, kg; null: any.")
    payload_com_mm: PointMm | None = Field(None, description="Its centre in the tool frame, mm; null: the tool point.")
    direction: list[int] | None = Field(None, description="Direction to reach each joint from, -1 or 1; null: any.")
    information_factor: float | None = Field(None, description="How much more is known after it, as a factor.")
    pose_id: int | None = Field(None, description="Number of the pose, for the column of that name.")
    session: int | None = Field(None, description="Number of the cycle, for the column of that name.")


class Proposal(Stored):
    """Poses that belong together."""

    kind: str | None = Field(None, description="`new`, or what is done again.")
    change: str | None = Field(None, description="What to change before them, in words; null: nothing.")
    poses: int | None = Field(None, description="How many poses.")
    information_factor: float | None = Field(None, description="How much more is known after them, as a factor.")


class PlanResult(Stored):
    """Poses to measure. Collisions are not checked."""

    purpose: str | None = Field(None, description="What the poses are for.")
    start: str | None = Field(None, description="The version it was planned with; null: the nominal robot.")
    count: int | None = Field(None, description="How many poses.")
    poses: list[PlannedPose] | None = Field(None, description="The poses, in the order of a short path.")
    csv: str | None = Field(None, description="The poses as a CSV file of columns of a measurement.")
    cycles: int | None = Field(None, description="Cycles of the standard's poses.")
    cycles_demanded: int | None = Field(None, description="Cycles that the standard demands.")
    separates: list[str] | None = Field(None, description="The two that the poses tell apart.")
    correlation: float | None = Field(None, description="Correlation of their signatures so far, 0 to 1.")
    told_apart: ToldApart | None = Field(None, description="Of `separate`: whether the poses tell the two apart.")
    proposals: list[Proposal] | None = Field(None, description="The poses, by what to change before them.")
    false_alarm: float | None = Field(
        None, description="Of `check`: chance of a false alarm at which it will say `moved`."
    )
    smallest: list[SmallestChange] | None = Field(
        None, description="Of `check`: the smallest changes that these poses show in 95 % of the checks."
    )
    unseen: list[str] | None = Field(None, description="Of `check`: what these poses do not show, in words.")
    faint: list[str] | None = Field(
        None, description="Of `check`: zeros of which these poses do not show a small step, and what would, in words."
    )
    within: str | None = Field(None, description="Where poses were looked for.")
    warnings: list[Remark] | None = Field(None, description="What to know before driving them.")


PLAN = JobContract(
    "plan",
    noun="plan of poses",
    title="Plan poses",
    summary="Plan poses to measure; needs no campaign.",
    options=PlanOptions,
    result=PlanResult,
    seconds=(3.0, 0.3, 60.0),
    version_option="version",
    needs_campaigns=False,
    takes_folds=True,
    history=True,
    usual=("purpose", "count", "effects", "version", "payloads_kg"),
    uses={"train": "train"},
)
PlanJob: TypeAlias = JobOf[PlanOptions, PlanResult]
