"""What the server answers about server, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.typed.fits import StageErrors


class Check(Record):
    """One thing that was looked at."""

    detail: str
    """What was found, in words."""
    ok: bool
    """Whether it is as it should be."""


class Health(Record):
    """The state of the server."""

    checks: Mapping[str, Check]
    """What was looked at, by name."""
    status: str
    """`live`: it answers; `ready`: it can do its work."""
    version: str
    """Release of the server."""


class ResolvedReference(Record):
    """What a prefix, a name or `latest` stands for."""

    by: str
    """How it was found: what the reference was."""
    id: str
    """Its full id."""
    kind: str
    """What it is."""
    name: str
    """What people call it; empty: it has no name."""
    robot: str
    """Name of the robot it belongs to."""


class JobError(Record):
    """Why a job failed."""

    code: str
    """Stable name of the error."""
    message: str
    """What is wrong, and what helps."""


class Progress(Record):
    """How far a job is (0 to 1) and what it does."""

    fraction: float
    """How far it is, 0 to 1."""
    stage: str
    """What it does now, in words."""


class JobSummary(Record):
    """A job in a list."""

    asked_by: str
    """Who asked for it: name of the token; empty: not noted by an earlier release."""
    created_at: str
    """When it was asked for."""
    error: JobError | None
    """Why it failed; None: it did not."""
    finished_at: str | None
    """When it was over; None: not yet."""
    id: str
    """Id of the job, `job_` and 16 hexadecimal digits."""
    kind: str
    """Kind of the job."""
    name: str
    """What people call the job and the version it makes, at most 200 characters; empty: it has no name."""
    progress: Progress
    """How far it is."""
    robot: str
    """Name of the robot."""
    started_at: str | None
    """When it began; None: not yet."""
    state: str
    """`queued` and `running` become one of the other three."""


class MeasuredCampaign(Record):
    """A campaign, and when it was measured."""

    age_days: int
    """Whole days from then to now."""
    id: str
    """Id of the campaign."""
    measured_at: str
    """When it was measured; where nobody stated it, when its newest rows were sent."""
    name: str
    """Its name."""
    stated: bool
    """Whether that was stated; false: it is when the rows were sent."""
    when: str
    """The same in words."""


class ErrorsToday(Record):
    """Errors of the active version on some rows."""

    alarm: str | None
    """What the check said, if it is one that alarmed; None: it agreed, or it is none."""
    at: str
    """When that was."""
    campaigns: Records[MeasuredCampaign]
    """Where the rows are from; empty: they are gone."""
    errors: StageErrors
    """The errors."""
    job_id: str
    """The job that computed them."""
    refit: tuple[str, ...]
    """Frames that were fitted to these rows, `base` and `tool`; empty: none."""
    rows: str
    """Which rows that are, in words."""
    source: str
    """`evaluation` and `check`: of rows that no fit used; `held_out`: of rows that its own job held out; `fitted`: of the rows it was fitted to, which flatters."""


class NamedMissing(Record):
    """An effect that a search named, and whether the active version corrects it."""

    corrected: bool
    """Whether the active version has it."""
    id: str
    """Id of the effect."""
    joints: tuple[int, ...]
    """Its joints, from 1; empty: of the whole arm."""
    words: str
    """The effect as people say it, with its class where these data cannot tell them apart."""


class SearchToday(Record):
    """The newest gap search against what the active version corrects."""

    at: str
    """When it ended."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns it looked at."""
    job_id: str
    """The search."""
    named: Records[NamedMissing]
    """What it named."""
    next_poses: int
    """Poses that it proposes to measure."""
    open: str
    """What is not settled after it, in words."""
    sentence: str
    """What is missing now, in words."""
    start: str | None
    """The version it continued from; None: the nominal robot."""
    verdict: str | None
    """`no_gap`, `closed`, `provisional`, `unexplained`, or `not_known`: no noise is known apart from the fit."""


class Today(Record):
    """How good a robot is today, and what is missing in its active version."""

    changed: bool
    """Whether today's mean error is larger than that by more than chance explains."""
    compared: str
    """Both beside each other, in words; empty: there are not two."""
    controller_compensation: str
    """Whether the controller corrects the arm by itself: `none`; `factory`: by its maker's calibration; `kilter`: by a calibration that Kilter exported; `unknown`: nobody said."""
    larger_by_mm: float | None
    """By how much, mm; None: not larger."""
    missing: SearchToday | None
    """The newest gap search; None: nobody has looked."""
    newest: ErrorsToday | None
    """The errors of today; None: nothing is known."""
    not_evaluated: Records[MeasuredCampaign]
    """Campaigns since then that the version neither was fitted to nor evaluated on."""
    own: ErrorsToday | None
    """What the version's own job said when it was made."""
    robot: str
    """Name of the robot."""
    sentences: tuple[str, ...]
    """The same in words, the most important first."""
    version_id: str | None
    """The active version; None: none."""


class Bridge(Record):
    """A bridge as the server knows it."""

    controller: str | None
    """Address of the controller; None: none asks."""
    corrected_twice: bool
    """Whether the controller corrects by itself, and this bridge offsets the joints on top of it."""
    cycle_ms: float
    """Cycle of the controller, ms."""
    cycles: int
    """Cycles answered since it began."""
    gone: bool
    """Whether it is gone: it has ended, was killed, or was not heard for 6 s; then nothing corrects the arm."""
    heard_at: str
    """When it was last heard."""
    id: str
    """Id of the run of this bridge."""
    kind: str
    """Controller: `rsi` KUKA, `egm` ABB, `fci` Franka."""
    largest_offset_deg: float
    """Largest offset of a joint since it began, degrees."""
    late: int
    """Answers later than a cycle; to a Franka robot these are not sent."""
    lost: int
    """Cycles for which no request came."""
    offset_deg: float
    """Largest offset of a joint now, degrees."""
    other_version: bool
    """Whether it corrects with a version that is not the active one."""
    refused: int
    """Cycles whose joints could not be corrected."""
    robot: str
    """Name of the robot."""
    sentence: str
    """The same in words."""
    silent_s: float
    """For how long it has not been heard, s."""
    since: str
    """When it was first heard."""
    state: str
    """What it does; `killed`: it vanished without saying that it ends."""
    version_id: str
    """The version it corrects with."""
    why: str
    """Why it does not correct; empty where it does."""


class BridgeList(Record):
    """Bridges of a robot: those that run first, then the newest. Those that are gone for a day are forgotten."""

    bridges: Records[Bridge]
    """The bridges."""
