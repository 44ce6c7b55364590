"""How good a robot is today: the newest error that no fit had a part in, and what its active version leaves uncorrected."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from kilter_service.contract.fits import StageErrors
from kilter_service.contract.units import COMPENSATION, INTERVAL, TOLERANCE, ControllerCompensation, Mm, Strict

RobotState = Literal[
    "worse", "moved", "cannot_tell", "changed", "outside", "unchecked", "drifting", "near", "uncalibrated", "not_known",
    "as_calibrated", "within",
]  # fmt: skip
StepKind = Literal[
    "activate", "rezero", "record_repair", "measure", "plan", "plan_check", "upload", "search", "identify", "await_job",
    "evaluate", "correct",
]  # fmt: skip
FirstStage = Literal["describe", "measure", "check", "search", "activate", "correct"]


class NextStep(Strict):
    """Something to do next."""

    do: StepKind = Field(
        description="What: `activate` a version, `rezero` what moved, `record_repair`, `measure` poses that a job proposes, "
        "`plan` poses of a first calibration, `plan_check`, `upload` measurements, `search` for what is missing, `identify` "
        "from pictures, `await_job` that searches, `evaluate` the version on a campaign, `correct` a path or a stream."
    )
    words: str = Field(description="The same as a button says it.")
    command: str = Field(description="The command that does it.")
    version_id: str | None = Field(None, description="The version to activate; null: none.")
    campaign_id: str | None = Field(None, description="The campaign whose rows it takes; null: none.")
    job_id: str | None = Field(None, description="The job whose poses are measured, or that runs; null: none.")
    causes: list[str] = Field([], description="Of `rezero` what moved, as `zero_3`.")


class ErrorAt(Strict):
    """A mean error of the version that was active, on rows that no fit used."""

    at: datetime = Field(description="When the rows were measured.")
    mean_mm: Mm = Field(description="Mean error, mm.")
    low_mm: Mm | None = Field(description="Lower end of its 95 % interval, mm; null: not known.")
    high_mm: Mm | None = Field(description="Upper end, mm.")
    source: Literal["evaluation", "check"] = Field(description="What computed it.")
    job_id: str = Field(description="The job that did.")
    version_id: str = Field(description="The version.")
    campaign_id: str = Field(description="The campaign of the rows.")
    alarm: bool = Field(description="Whether it is a check that alarmed.")


class FirstStep(Strict):
    """A stage of the first calibration of an arm."""

    stage: FirstStage = Field(
        description="`describe` the arm, `measure` it, `check` the file, identify and `search`, `activate`, `correct`."
    )
    words: str = Field(description="The same as the strip of the page says it.")
    done: bool = Field(description="Whether it is done.")
    missing: str = Field(description="What is missing, in words; empty: it is done, or another comes first.")
    steps: list[NextStep] = Field(
        description="How to do it, the best first; empty: it is done, or another comes first."
    )


class Standing(Strict):
    """How a robot stands, and what to do next."""

    state: RobotState = Field(
        description="What is worst: `worse` than the nominal arm; `moved`, or `cannot_tell` what moved, by the last check; "
        "`changed`: larger errors than at the fit; `outside` the tolerance; `unchecked` for longer than the interval; "
        "`drifting`: all checks together; `near`: the tolerance is inside the interval of the error; `uncalibrated`: no "
        "active version; `not_known`: nothing was held out; `as_calibrated`: no tolerance is stated; `within` it."
    )
    words: str = Field(description="The same in a few words.")
    sentence: str = Field(description="What it rests on.")
    look: Literal["good", "warn", "bad", "faint"] = Field(description="How loud that is.")
    tolerance_mm: Mm | None = Field(None, description=f"{TOLERANCE} Null: none is stated.")
    check_interval_days: int | None = Field(None, description=f"{INTERVAL} Null: none is stated.")
    without_mm: Mm | None = Field(
        None, description="Mean error of the nominal arm on the same rows, mm: without the version. Null: not known."
    )
    steps: list[NextStep] = Field([], description="What to do next, the best first.")
    first: list[FirstStep] = Field(
        [],
        description="The first calibration, stage by stage, until the arm is corrected with an active version; then empty.",
    )


Source = Literal["evaluation", "check", "held_out", "fitted"]
UNUSED: frozenset[Source] = frozenset({"evaluation", "check"})  # rows that no fit used


class MeasuredCampaign(Strict):
    """A campaign, and when it was measured."""

    id: str = Field(description="Id of the campaign.")
    name: str = Field(description="Its name.")
    measured_at: datetime = Field(
        description="When it was measured; where nobody stated it, when its newest rows were sent."
    )
    stated: bool = Field(description="Whether that was stated; false: it is when the rows were sent.")
    age_days: int = Field(description="Whole days from then to now.")
    when: str = Field(description="The same in words.")


class ErrorsToday(Strict):
    """Errors of the active version on some rows."""

    source: Source = Field(
        description="`evaluation` and `check`: of rows that no fit used; `held_out`: of rows that its own job held out; "
        "`fitted`: of the rows it was fitted to, which flatters."
    )
    job_id: str = Field(description="The job that computed them.")
    at: datetime = Field(description="When that was.")
    campaigns: list[MeasuredCampaign] = Field(description="Where the rows are from; empty: they are gone.")
    refit: list[str] = Field(description="Frames that were fitted to these rows, `base` and `tool`; empty: none.")
    rows: str = Field(description="Which rows that are, in words.")
    errors: StageErrors = Field(description="The errors.")
    alarm: str | None = Field(
        None, description="What the check said, if it is one that alarmed; null: it agreed, or it is none."
    )


class NamedMissing(Strict):
    """An effect that a search named, and whether the active version corrects it."""

    id: str = Field(description="Id of the effect.")
    joints: list[int] = Field(description="Its joints, from 1; empty: of the whole arm.")
    words: str = Field(
        description="The effect as people say it, with its class where these data cannot tell them apart."
    )
    corrected: bool = Field(description="Whether the active version has it.")


class SearchToday(Strict):
    """The newest gap search against what the active version corrects."""

    job_id: str = Field(description="The search.")
    at: datetime = Field(description="When it ended.")
    campaigns: list[str] = Field(description="Ids of the campaigns it looked at.")
    start: str | None = Field(description="The version it continued from; null: the nominal robot.")
    verdict: str | None = Field(
        description="`no_gap`, `closed`, `provisional`, `unexplained`, or `not_known`: no noise is known apart from the fit."
    )
    named: list[NamedMissing] = Field(description="What it named.")
    open: str = Field(description="What is not settled after it, in words.")
    next_poses: int = Field(description="Poses that it proposes to measure.")
    sentence: str = Field(description="What is missing now, in words.")


class Today(Strict):
    """How good a robot is today, and what is missing in its active version."""

    robot: str = Field(description="Name of the robot.")
    version_id: str | None = Field(description="The active version; null: none.")
    newest: ErrorsToday | None = Field(description="The errors of today; null: nothing is known.")
    own: ErrorsToday | None = Field(description="What the version's own job said when it was made.")
    changed: bool = Field(description="Whether today's mean error is larger than that by more than chance explains.")
    larger_by_mm: Mm | None = Field(description="By how much, mm; null: not larger.")
    compared: str = Field(description="Both beside each other, in words; empty: there are not two.")
    not_evaluated: list[MeasuredCampaign] = Field(
        description="Campaigns since then that the version neither was fitted to nor evaluated on."
    )
    missing: SearchToday | None = Field(description="The newest gap search; null: nobody has looked.")
    standing: Standing | None = Field(None, description="How the robot stands in a word, and what to do next.")
    history: list[ErrorAt] = Field([], description="Errors over time, oldest first; at most 200.")
    controller_compensation: ControllerCompensation = Field("unknown", description=COMPENSATION)
    sentences: list[str] = Field(description="The same in words, the most important first.")
