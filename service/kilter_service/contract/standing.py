"""How a robot stands, in a word, and what to do next."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from kilter_service.contract.units import INTERVAL, TOLERANCE, Mm, Strict

RobotState = Literal[
    "worse", "moved", "cannot_tell", "changed", "outside", "unchecked", "drifting", "near", "uncalibrated", "not_known",
    "as_calibrated", "within",
]  # fmt: skip
StepKind = Literal[
    "activate", "rezero", "record_repair", "measure", "plan", "plan_check", "upload", "search", "await_job", "evaluate",
    "correct",
]  # fmt: skip
FirstStage = Literal["describe", "measure", "check", "search", "activate", "correct"]


class NextStep(Strict):
    """Something to do next."""

    do: StepKind = Field(
        description="What: `activate` a version, `rezero` what moved, `record_repair`, `measure` poses that a job proposes, "
        "`plan` poses of a first calibration, `plan_check`, `upload` measurements, `search` for what is missing, `await_job` "
        "that searches, `evaluate` the version on a campaign, `correct` a path or a stream."
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
