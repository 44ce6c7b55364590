"""What the server answers about drifts, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownDrift
from kilter_client.typed.fits import Metrics, Objection, Parameter, Remark, StageErrors
from kilter_client.typed.plans import SmallestChange


class ChangedNumber(Record):
    """A number that changed."""

    change: float
    """By how much it changed."""
    name: str
    """`value`, or of a frame `x`, `y`, `z`, `rx`, `ry`, `rz` in the frame itself."""
    summed: float | None
    """The change by weights that no temperature changes: what control charts sum. Null: stored without."""
    summed_u95: float | None
    """Half width of the 95 % interval of that: how much it counts. Null: stored without, or not shown."""
    u95: float | None
    """Half width of its 95 % interval; None: the rows do not show this number."""
    unit: str
    """Its unit: deg, mm, deg/(N m), mm/N, ppm."""


class DriftCause(Record):
    """A cause that was looked at."""

    bic: float | None
    """What it leaves, with a price for its numbers; smaller is better."""
    gain: float | None
    """Chi-square that it explains."""
    joint: int | None
    """Joint, from 1; None: none."""
    kind: str | None
    """What changed."""
    name: str
    """`zero_3`, `sag_2`, `base`, `tool`, `scale`."""
    numbers: Records[ChangedNumber]
    """What changed, if this is the cause."""
    refuted: bool | None
    """Whether the best cause explains what this one leaves."""
    words: str | None
    """The cause as people say it."""


class DriftResult(ShownDrift, Record):
    """Whether an arm has moved since its version was made, and by what."""

    agreed_at: str | None
    """When a check measured before last agreed with the version and showed every cause that may be it otherwise than these rows; None: none did."""
    causes: Records[DriftCause]
    """What explains the rows, best first; empty: nothing did."""
    chi_square: float | None
    """Squared whitened innovation."""
    expected_mm: float | None
    """Standard deviation of a coordinate, mm, by which the fit missed beyond that."""
    false_alarm: float | None
    """Chance of a false alarm at which it says `moved`."""
    fitted_c: tuple[float, ...]
    """Lowest and highest temperature, degrees Celsius, of the rows of the fit; None: not known."""
    joint_log: bool | None
    """Whether nobody measured a place, and rows were compared with each other, in their sockets."""
    lengths: str | None
    """Where `misfit_mm` and `noise_mm` are: `at_tool`, or `by_views`, beside its rotation, as sure as a typical view."""
    looked_at: Records[DriftCause]
    """All causes that these rows show, best first."""
    metrics: Mapping[str, StageErrors]
    """Errors of the version on the rows, `identified`, by campaign, as an evaluation gives them."""
    misfit_mm: float | None
    """Root mean square distance of measured and predicted points, mm (see `lengths`)."""
    new_setup: tuple[str, ...]
    """Frames that were set up anew."""
    noise_mm: float | None
    """Standard deviation of a coordinate that counted as noise, mm (see `lengths`)."""
    numbers: int | None
    """Numbers that it sums over."""
    p_value: float | None
    """Chance of so much from an arm that has not moved."""
    poses: int | None
    """Distinct poses that counted."""
    refit: tuple[str, ...]
    """The same, as an evaluation calls them: fitted to these rows."""
    remedy: str | None
    """What to do, or what would settle it; None: nothing."""
    scatter: float | None
    """How many times the expected scatter the rows have, at least 1; 1 of a stated noise; None: stored without."""
    sentence: str | None
    """The same in words."""
    setup_mm: float | None
    """Standard deviation with which the set-up was taken to repeat, mm; None: stored without."""
    smallest: Records[SmallestChange]
    """The smallest changes that these rows show."""
    temperature_c: float | None
    """Mean temperature of the rows, degrees Celsius; None: not known."""
    unseen: tuple[str, ...]
    """Causes that move nothing that was measured, in words."""
    verdict: str | None
    """`ok`; `moved`: by the one cause; `cannot_tell`: it moved, by one of several or by none of these."""
    version_id: str | None
    """The version that was checked."""
    warnings: Records[Remark]
    """What to know before trusting the result."""
    within_k: float | None
    """By how many K the arm may differ from its temperature at the fit, as far as the check goes; 0: both are stated, or it makes no difference; None: stored without."""


class RezeroResult(ShownDrift, Record):
    """A version in which the one or few parameters that moved are as these rows say, and all others as before."""

    causes: Records[DriftCause]
    """What moved."""
    metrics: Metrics | None
    """Errors on these rows."""
    objections: Records[Objection]
    """What it found against activating the version."""
    p_after: float | None
    """Chance of the rows by the new version."""
    p_before: float | None
    """Chance of the rows by the version that was changed."""
    parameters: Records[Parameter]
    """The parameters that changed, as they are now."""
    sentence: str | None
    """What was changed, in words."""
    start: str | None
    """The version that was changed."""
    version_id: str | None
    """Id of the version it made; None: none."""
    warnings: Records[Remark]
    """What to know before trusting the result."""


class CheckOfRobot(Record):
    """A check of an arm."""

    at: str
    """When its rows were measured; where nobody stated it, when they were sent."""
    campaign_id: str
    """Its campaign."""
    job_id: str
    """The job that made it."""
    p_value: float
    """Chance of so much from an arm that has not moved."""
    sentence: str
    """The same in words."""
    temperature_c: float | None
    """Mean temperature, degrees Celsius; None: not known."""
    verdict: str
    """What it said."""
    version_id: str
    """The version it was checked against."""
    whole: bool
    """Whether every cause was looked at. False of frames that were set up anew and of a joint log alone: such a check says how the arm stands, and is in no chart."""


class ControlChart(Record):
    """Sums of one number over the checks of the active version: what it differs by from the checks before, and keeps doing."""

    alarms: bool
    """Whether the sum is beyond the limit."""
    down: tuple[float | None, ...]
    """Sum downwards."""
    limit: float
    """Sum beyond which it alarms."""
    name: str
    """Name of the cause; of base and tool with the axis of the shift, `base_x`."""
    scatter: float | None
    """Standard deviation of the values; None: too few checks."""
    since: str | None
    """When the change that alarms most likely began, if it came at once; one that comes little by little began earlier. Null: none does."""
    unit: str
    """Unit of the values: deg, mm, deg/(N m), mm/N, ppm."""
    up: tuple[float | None, ...]
    """Sum upwards, in standard deviations; None: too few checks, or one that alarmed by itself."""
    values: tuple[float | None, ...]
    """What each check says it changed by; None: it does not show it."""
    words: str
    """The same as people say it."""


class DriftMark(Record):
    """Something that was done to a robot or its version between checks."""

    at: str
    """When."""
    note: str
    """Of a repair what was done."""
    repair_id: str | None
    """Id of a repair; None: it is none."""
    version_id: str
    """The version; of a repair empty."""
    what: str
    """What: `activated`, `re-zeroed` (a version of the parameters that moved), `rolled back`; `repaired`: the first check that agrees again with a version that the check before missed; `repair`: what somebody recorded."""


class DriftSummary(Record):
    """How a robot stands by its checks."""

    age_days: int | None
    """Whole days since then; None: none."""
    checks: int
    """Checks of the active version, since the last repair."""
    last: CheckOfRobot | None
    """The last of them; None: none."""
    robot: str
    """Name of the robot."""
    sentence: str
    """The same in words."""
    state: str
    """`never`: not checked since its version was activated or the arm repaired; `ok`; `creeping`: no check says so, all together do; `cannot_tell` and `moved`: the last check."""
    version_id: str | None
    """The active version; None: none."""


class DriftHistory(DriftSummary):
    """The checks of a robot, oldest first, and the control charts of its active version."""

    charts: Records[ControlChart]
    """A chart for each number, over the checks of the active version that looked at every cause."""
    false_alarm: float
    """Chance at which a single check says that the arm has moved."""
    history: Records[CheckOfRobot]
    """All checks against any version, oldest first; at most 1000."""
    marks: Records[DriftMark]
    """What was done to its version, oldest first."""
    repaired_at: str | None
    """When the arm was last repaired: checks and charts of the active version count from then on."""
    run_length: int
    """Checks between two false alarms of all charts together."""


class DriftList(Record):
    """How all robots stand, the worst first."""

    robots: Records[DriftSummary]
    """The robots, the worst first."""


class Repair(Record):
    """A repair of an arm: from then on it is another one for its checks."""

    at: str
    """When it was done."""
    by: str
    """Who recorded it."""
    created_at: str
    """When it was recorded."""
    id: str
    """Its id."""
    what: str
    """What was done."""
