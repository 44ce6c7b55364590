"""What the work of a kind of job is; ``contract/jobs`` declares the kinds, ``kinds/`` has a module of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from kilter_core.errors import CoreError, FindingDocument, ObservationError
from kilter_service.contract.jobs.kind import JobContract
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.settings import Queue

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_core.arm import Robot
    from kilter_core.gap import GapCheck
    from kilter_core.identify import FleetVersion, IdentificationCheck
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations
    from kilter_core.types import Each
    from kilter_service.contract.devices import Instrument
    from kilter_service.contract.wording import Remark
    from kilter_service.versions.drift.wire import StoredCheck


How = Literal["campaigns", "fraction", "folds", "unasked", "none"]


@dataclass(frozen=True)
class Lack:
    """What a job would run without: what, why, and what to measure or to give."""

    what: str
    reason: str
    remedy: str


@dataclass
class JobPreview:
    """What was found; a kind fills it as far as it comes. ``rows`` are those to learn from, with what is held out."""

    rows: int = 0
    poses: int = 0
    how: How = "none"
    held_rows: int = 0
    held_poses: int = 0
    problems: list[CoreError] = field(default_factory=list)
    missing: list[Lack] = field(default_factory=list)
    limited: list[str] = field(default_factory=list)
    identification: IdentificationCheck | None = None
    search: GapCheck | None = None
    seconds: float | None = None  # that the job would take, where its beginning says so

    @contextmanager
    def noting_refusals(self) -> Iterator[None]:
        """Note why the job would fail, instead of failing."""
        try:
            yield
        except CoreError as error:
            self.problems.append(error)

    def count_fitted_rows(self, *parts: Observations) -> None:
        """Count the rows that are fitted, split or compared; of parts that are taken one by one, poses of each."""
        self.rows, self.poses = sum(len(rows) for rows in parts), sum(count_poses(rows) for rows in parts)

    def hold(self, how: How, *parts: Observations) -> None:
        """Count what is held out."""
        self.how = how
        self.held_rows, self.held_poses = sum(len(rows) for rows in parts), sum(count_poses(rows) for rows in parts)


def count_poses(rows: Observations) -> int:
    """Count distinct poses."""
    return int(rows.pose_groups().max()) + 1 if len(rows) else 0


@dataclass(frozen=True)
class Dates:
    """When the rows of a job were measured or sent, the last check of the version, and, as stated, what it was fitted to."""

    rows: datetime | None = None
    last_check: datetime | None = None
    fitted: datetime | None = None


@dataclass(frozen=True)
class FitOfVersion:
    """What a version was fitted to: the lowest and highest temperature (deg C) of those rows, None where nobody stated it,
    and which campaigns of the job have rows of it. ``agreeing`` are checks that agreed with it, measured before the job's rows.
    ``fitted`` counts by campaign the rows that were fitted, whatever file they came in. ``instruments`` are the names of those
    that measured its rows, as far as campaigns name one.
    """

    temperatures_c: tuple[float, float] | None = None
    shared: tuple[str, ...] = ()
    agreeing: tuple[StoredCheck, ...] = ()
    fitted: Mapping[str, int] = field(default_factory=dict)
    dates: Dates = field(default_factory=Dates)
    instruments: frozenset[str] = frozenset()


Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class JobInput:
    """All a kind needs, loaded from the database. ``options`` are those of the kind, as the contract has them.

    ``validation`` is what the job names: rows, a fraction, folds.
    ``confirmation`` are campaigns in which what was found must be seen again.

    ``each`` computes independent parts, in several processes where the worker has them; None: one after the other.
    ``default_load`` are the campaigns that state no payload, where the robot has a default load; ``no_load`` those where
    it has none, so that nothing counts as carried.
    ``masses_from`` names the search in torques whose masses the robot has.
    ``devices``, ``names`` and ``instruments`` (of those that name one) are those of all campaigns, by id, and
    ``certificates`` what those of the instruments have against a campaign.
    ``version_id``, ``calibration``, ``covariance`` and ``report`` are those of
    the version the options name (``JobContract.version_option``), ``made_from`` the campaigns it was made from. Only for kinds
    with ``history``: ``driven (N, n)`` joint readings of all the robot's campaigns, and ``origin``, the result of the job
    that made the version. ``fit``: what the version was fitted to. ``fleet`` are
    versions of other robots of the type, one of each, where the option ``prior`` asks for them.
    """

    robot: Robot
    campaigns: dict[str, Observations]
    validation: dict[str, Observations] | float | int | None
    options: Any
    version_id: str | None = None
    calibration: Calibration | None = None
    covariance: dict[str, Any] | None = None
    report: dict[str, Any] | None = None
    devices: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    instruments: dict[str, Instrument] = field(default_factory=dict)
    certificates: dict[str, list[Remark]] = field(default_factory=dict)
    driven: NDArray[np.float64] | None = None
    origin: dict[str, Any] | None = None
    fit: FitOfVersion = FitOfVersion()
    confirmation: dict[str, Observations] = field(default_factory=dict)
    default_load: tuple[str, ...] = ()
    no_load: tuple[str, ...] = ()
    masses_from: str | None = None
    each: Each | None = None
    fleet: tuple[FleetVersion, ...] = ()
    made_from: frozenset[str] = frozenset()

    def applied_to(self, campaign: str) -> Calibration | None:
        """The version as it predicts the rows of a campaign: what happened once, in those it was made from, has happened."""
        if self.calibration is None or campaign in self.made_from:
            return self.calibration
        return self.calibration.for_another_campaign(self.campaigns[campaign])

    def refuse_rows_of_start(self) -> None:
        """Refuse campaigns that are to judge a fit where the version it starts from was fitted to their rows.

        Raises:
            ObservationError: ``rows_shared``, with the campaign.

        """
        for campaign in self.fit.shared:
            raise ObservationError(
                f"The start {self.version_id} was fitted to rows of campaign {self.names.get(campaign, campaign)}, so they "
                "cannot judge what continues it. Name other rows for validation or confirmation, or no start.",
                code="rows_shared",
                campaign=campaign,
            )

    @property
    def start(self) -> Calibration | None:
        """The version as a fit of the campaigns begins with it: laws of time of other campaigns are not carried to them."""
        found = self.calibration
        if found is None or self.made_from & self.campaigns.keys():
            return found
        for rows in self.campaigns.values():
            found = found.for_another_campaign(rows)
        return found

    @property
    def rows_by_campaign(self) -> dict[str, Observations]:
        """Rows of all campaigns the job names, whatever it takes them for."""
        held = self.validation if isinstance(self.validation, dict) else {}
        return {**self.campaigns, **held, **self.confirmation}


@dataclass(frozen=True)
class VersionContent:
    """What a job puts into the version it makes; of ``limits`` those fields count that were asked for.

    ``parent_id`` is the version that it continues, where the options do not name it.
    """

    calibration: dict[str, Any]
    report: dict[str, Any]
    covariance: dict[str, Any]
    limits: CorrectionLimits = field(default_factory=CorrectionLimits)
    parent_id: str | None = None


@dataclass(frozen=True)
class JobOutput:
    """The result document, JSON-able; and the content of the version the job makes, if it makes one."""

    result: dict[str, Any]
    version: VersionContent | None = None

    def with_warnings(self, *remarks: FindingDocument) -> JobOutput:
        """The same with more warnings in result and version; what has warnings of a code already gets none of that code."""
        if not remarks:
            return self
        version = self.version
        return JobOutput(
            _add_warnings(self.result, remarks),
            None if version is None else replace(version, report=_add_warnings(version.report, remarks)),
        )


def _add_warnings(document: dict[str, Any], remarks: Sequence[FindingDocument]) -> dict[str, Any]:
    said = document.get("warnings") or []
    known = {one.get("code") for one in said}
    new = [one for one in remarks if one["code"] not in known]
    return {**document, "warnings": [*said, *new]} if new else document


def refuse_nothing(_: Any) -> None:
    """Leave the options to their model."""


def describe_no_details(_: JobPreview) -> dict[str, Any]:
    """Say of a preview what every kind says, and no more."""
    return {}


@dataclass(frozen=True)
class JobKind:
    """The work of a kind of job, beside its declaration in the contract.

    ``check`` refuses at once, before the job is queued, what the model of the options
    cannot say (which options go together); it raises a CoreError. ``run`` computes: it gets
    ``progress(fraction, stage)``, which raises ``CancelledError`` when the job was cancelled, and must call it at
    least once a second. Both import core inside, because the API process lists the kinds without it.
    ``preview_job`` fills in what such a job would do, at once, from the same input; without it only its rows are counted.
    ``describe_preview`` says what its check has beside those of other kinds.
    """

    contract: JobContract[Any, Any]
    run: Callable[[JobInput, Progress], JobOutput]
    check: Callable[[Any], None] = refuse_nothing
    preview_job: Callable[[JobInput, JobPreview], None] | None = None
    describe_preview: Callable[[JobPreview], dict[str, Any]] = describe_no_details

    @property
    def name(self) -> str:
        """Its name in a request."""
        return self.contract.name

    @property
    def queue(self) -> Queue:
        """Queue of its jobs; a worker runs one job of each at a time."""
        return "long" if self.contract.long else "short"
