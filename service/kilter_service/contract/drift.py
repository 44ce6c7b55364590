"""The checks of robots one after another: whether each has moved, and what creeps."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field, StringConstraints

from kilter_service.contract.jobs.drift import DriftVerdict
from kilter_service.contract.units import Celsius, Strict

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
