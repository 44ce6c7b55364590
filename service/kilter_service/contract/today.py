"""How good a robot is today, how its checks stand one after another, and whether it keeps a tolerance (ISO 14253-1)."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field, StringConstraints

from kilter_service.contract.budgets import Budget
from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.contract.jobs.drift import DriftVerdict
from kilter_service.contract.units import COMPENSATION, INTERVAL, TOLERANCE, Celsius, ControllerCompensation, Mm, Strict
from kilter_service.contract.wording import Remark

RobotState = Literal[
    "worse",
    "moved",
    "cannot_tell",
    "changed",
    "outside",
    "unchecked",
    "drifting",
    "near",
    "uncalibrated",
    "not_known",
    "as_calibrated",
    "within",
]
StepKind = Literal[
    "activate",
    "rezero",
    "record_repair",
    "measure",
    "plan",
    "plan_check",
    "upload",
    "search",
    "identify",
    "await_job",
    "evaluate",
    "correct",
]
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


Mark = Literal["activated", "re-zeroed", "rolled back", "repaired", "repair", "note"]
State = Literal["never", "ok", "creeping", "cannot_tell", "moved"]


class CheckOfRobot(Strict):
    """A check of an arm."""

    job_id: str = Field(description="The job that made it.")
    campaign_id: str = Field(description="Its campaign.")
    version_id: str = Field(description="The version it was checked against.")
    at: datetime = Field(description="When its rows were measured; where nobody stated it, when they were sent.")
    verdict: DriftVerdict = Field(description="What it said.")
    sentence: str = Field(description="The same in words.")
    p_value: float = Field(description="Chance of so much from an arm that has not moved.")
    temperature_c: Celsius | None = Field(description="Mean temperature, degrees Celsius; null: not known.")
    whole: bool = Field(
        True,
        description="Whether every cause was looked at. False of frames that were set up anew and of a joint log alone: such a "
        "check says how the arm stands, and is in no chart.",
    )


class ControlChart(Strict):
    """Sums of one number over the checks of the active version: what it differs by from the checks before, and keeps doing."""

    name: str = Field(description="Name of the cause; of base and tool with the axis of the shift, `base_x`.")
    words: str = Field(description="The same as people say it.")
    unit: str = Field(description="Unit of the values: deg, mm, deg/(N m), mm/N, ppm.")
    values: list[float | None] = Field(description="What each check says it changed by; null: it does not show it.")
    up: list[float | None] = Field(
        description="Sum upwards, in standard deviations; null: too few checks, or one that alarmed by itself."
    )
    down: list[float | None] = Field(description="Sum downwards.")
    limit: float = Field(description="Sum beyond which it alarms.")
    scatter: float | None = Field(description="Standard deviation of the values; null: too few checks.")
    alarms: bool = Field(description="Whether the sum is beyond the limit.")
    since: datetime | None = Field(
        description="When the change that alarms most likely began, if it came at once; one that comes little by little began "
        "earlier. Null: none does."
    )


RepairKind = Literal["repair", "note"]
KIND_OF_REPAIR = "`repair`: checks begin anew with it; `note`: it is marked at its date, and changes nothing."
CAMPAIGN_OF_NOTE = "Id of the campaign that a note is on; null: on none."
ROWS_OF_NOTE = "Rows of the campaign that a note is on, as `1-3,7`; empty: on all."


class DriftMark(Strict):
    """Something that was done to a robot or its version between checks."""

    at: datetime = Field(description="When.")
    what: Mark = Field(
        description="What: `activated`, `re-zeroed` (a version of the parameters that moved), `rolled back`; `repaired`: the "
        "first check that agrees again with a version that the check before missed; `repair` and `note`: what "
        "somebody recorded."
    )
    version_id: str = Field(description="The version; of a repair and a note empty.")
    note: str = Field("", description="Of a repair what was done, of a note what it says.")
    repair_id: str | None = Field(None, description="Id of a repair or a note; null: it is none.")
    campaign_id: str | None = Field(None, description=CAMPAIGN_OF_NOTE)
    rows: str = Field("", description=ROWS_OF_NOTE)


class NewRepair(Strict):
    """What was done to an arm, or a note on a date, a campaign or its rows."""

    what: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=200)] = Field(
        description="What was done, as *gear of joint 3 replaced*."
    )
    at: AwareDatetime | None = Field(None, description="When; null: now.")
    kind: RepairKind = Field("repair", description=KIND_OF_REPAIR)
    campaign_id: str | None = Field(None, max_length=32, description=CAMPAIGN_OF_NOTE)
    rows: str = Field("", max_length=200, pattern=r"^[0-9,-]*$", description=ROWS_OF_NOTE)


class Repair(Strict):
    """A repair of an arm: from then on it is another one for its checks."""

    id: str = Field(description="Its id.")
    at: datetime = Field(description="When it was done.")
    what: str = Field(description="What was done.")
    by: str = Field(description="Who recorded it.")
    kind: RepairKind = Field("repair", description=KIND_OF_REPAIR)
    campaign_id: str | None = Field(None, description=CAMPAIGN_OF_NOTE)
    rows: str = Field("", description=ROWS_OF_NOTE)
    created_at: datetime = Field(description="When it was recorded.")


class DriftSummary(Strict):
    """How a robot stands by its checks."""

    robot: str = Field(description="Name of the robot.")
    state: State = Field(
        description="`never`: not checked since its version was activated or the arm repaired; `ok`; `creeping`: no check says "
        "so, all together do; `cannot_tell` and `moved`: the last check."
    )
    version_id: str | None = Field(description="The active version; null: none.")
    sentence: str = Field(description="The same in words.")
    checks: int = Field(description="Checks of the active version, since the last repair.")
    last: CheckOfRobot | None = Field(description="The last of them; null: none.")
    age_days: int | None = Field(description="Whole days since then; null: none.")


class DriftHistory(DriftSummary):
    """The checks of a robot, oldest first, and the control charts of its active version."""

    repaired_at: datetime | None = Field(
        None, description="When the arm was last repaired: checks and charts of the active version count from then on."
    )
    history: list[CheckOfRobot] = Field(description="All checks against any version, oldest first; at most 1000.")
    marks: list[DriftMark] = Field(description="What was done to its version, oldest first.")
    charts: list[ControlChart] = Field(
        description="A chart for each number, over the checks of the active version that looked at every cause."
    )
    run_length: int = Field(description="Checks between two false alarms of all charts together.")
    false_alarm: float = Field(description="Chance at which a single check says that the arm has moved.")


class DriftList(Strict):
    """How all robots stand, the worst first."""

    robots: list[DriftSummary] = Field(description="The robots, the worst first.")


Decision = Literal["accepted", "rejected", "not_proved"]
Span = tuple[Mm, Mm]


class JudgedCampaign(Strict):
    """Rows of a campaign that the version was not fitted to, and what it leaves of them."""

    id: str = Field(description="Id of the campaign.")
    name: str = Field(description="Its name.")
    when: str = Field(description="When it was measured, in words.")
    instrument: str | None = Field(description="Name of the instrument; null: none is named.")
    rows: int = Field(description="Rows judged.")
    sha256: list[str] = Field(description="SHA-256 of its files.")
    refit: list[str] = Field(description="Frames that were fitted to these rows; empty: none.")
    before: Errors = Field(description="Errors of the nominal robot, base and tool fitted to these rows.")
    after: Errors = Field(description="Errors of the version.")
    largest_mm: Mm = Field(description="Largest error of a row, mm.")
    row: int = Field(description="Row of the campaign that decides, from 1.")
    error_mm: Mm = Field(description="Its error, mm.")
    guard_band_mm: Mm = Field(description="Expanded uncertainty of that error, k = 2, mm: the guard band.")
    provable_mm: Mm = Field(description="Smallest tolerance that the rows prove, mm.")
    budget: Budget = Field(description="What is not known of these rows.")
    at_mm: list[tuple[Mm, Mm, Mm]] = Field(description="Measured places, mm; of many rows 500, evenly chosen.")
    error_at_mm: list[Mm] = Field(description="The error at each of them, mm.")


class Acceptance(Strict):
    """A decision about a tolerance of the position of the tool."""

    robot: str = Field(description="Name of the robot.")
    robot_sha256: str = Field(description="SHA-256 of the robot's chain.")
    version_id: str = Field(description="The version that was judged.")
    version_name: str = Field(description="What people call it; empty: it has no name.")
    version_sha256: str = Field(description="Its SHA-256.")
    tolerance_mm: Mm = Field(description="Tolerance of the distance of the tool from where it should be, mm.")
    decision: Decision = Field(
        description="`accepted`: every error and its guard band are within the tolerance; `rejected`: an error is beyond it "
        "by its guard band; `not_proved`: neither can be proved."
    )
    rule: str = Field(description="The decision rule, in words.")
    sentence: str = Field(description="The decision, in words.")
    rows: int = Field(description="Rows judged; no fit of the version or of one that it continues used them.")
    provable_mm: Mm = Field(description="Smallest tolerance that all rows prove, mm.")
    span_mm: dict[str, Span] = Field(description="From where to where the rows were measured, by axis, mm.")
    campaigns: list[JudgedCampaign] = Field(description="The rows by campaign, the one that decides first.")
    lacking: list[Remark] = Field(
        description="Why nothing can be proved whatever the numbers; empty: nothing is lacking."
    )
    warnings: list[Remark] = Field(description="What to know before trusting the decision.")
