"""Jobs as they are stored.

What a version was fitted to, as far as a check asks: at which temperatures, to which rows; and which checks agreed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

from kilter_service.campaigns import store as campaigns
from kilter_service.ground.db import Session
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.kind import Dates, FitOfVersion
from kilter_service.robots import store as repairs
from kilter_service.versions import store as versions
from kilter_service.versions.drift import store as drift
from kilter_service.versions.predictions.unfitted_rows import Archive


@dataclass(frozen=True)
class JobRequest:
    """What was asked, as it was sent: ``validation`` is campaign ids, a fraction, {"folds": n}, or None."""

    robot: str
    campaigns: list[str]
    validation: list[str] | float | dict[str, int] | None
    confirmation: list[str]
    options: dict[str, Any]

    @staticmethod
    def from_document(document: dict[str, Any]) -> JobRequest:
        """Read a stored request; jobs of earlier releases have no confirmation."""
        return JobRequest(
            document["robot"],
            document.get("campaigns") or [],
            document.get("validation"),
            document.get("confirmation") or [],
            document.get("options") or {},
        )

    @property
    def held_out_campaigns(self) -> list[str]:
        """Campaigns that are held out."""
        return self.validation if isinstance(self.validation, list) else []

    @property
    def input_campaigns(self) -> list[str]:
        """Campaigns that are fitted or searched, and held out of."""
        return [*self.campaigns, *self.held_out_campaigns]

    @property
    def folds(self) -> int | None:
        """Folds of a cross-validation."""
        return int(self.validation["folds"]) if isinstance(self.validation, dict) else None


@dataclass(frozen=True)
class UsedRecord:
    """A campaign as a job used it: ``use`` is train, validation or confirmation; the hashes are those of its uploads."""

    id: str
    name: str
    role: str
    use: str
    rows: int
    sha256: list[str]


class ProgressRecord(NamedTuple):
    """How far a job is."""

    id: str
    state: str
    fraction: float
    stage: str


@dataclass(frozen=True)
class Place:
    """Where a job stands that is not over: how many of its queue begin before it, and the worker that runs it.

    ``worker`` is empty while it waits.
    """

    before: int
    worker: str


@dataclass(frozen=True)
class Asked:
    """Which request asked for a job, and where that was in a trace; empty where nobody said."""

    request_id: str = ""
    traceparent: str = ""


@dataclass(frozen=True)
class ListedJob:
    """What a list tells of a job."""

    id: str
    kind: str
    robot: str
    name: str
    state: str
    fraction: float
    stage: str
    error: dict[str, str] | None
    asked_by: str
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


@dataclass(frozen=True)
class WantedJobs:
    """What is asked of the list of jobs: of one robot or of all, of a kind, in a state; each of ``words`` is in name, robot,
    author or id, or the kind is one of those beside it. ``order`` is a column, ``kinds`` and ``states`` in which order
    these two sort.
    """

    robot: str | None = None
    kind: str | None = None
    state: str | None = None
    words: Sequence[tuple[str, Collection[str]]] = ()
    order: str = "asked"
    falling: bool = True
    kinds: Sequence[str] = ()
    states: Sequence[str] = ()


@dataclass(frozen=True)
class JobRecord(ListedJob):
    """A stored job."""

    robot_id: int
    request: JobRequest
    attempts: int
    result: dict[str, Any] | None
    asked: Asked


def load_version_fit(session: Session, version: str, named: Sequence[str]) -> FitOfVersion:
    """Return what a version, and those that it continues, were fitted to, against the campaigns that a job names."""
    trained = [one for training in versions.trainings(session, version) for one in training.campaigns]
    hashes = {sha256 for _, each in trained for sha256 in each}
    robot = versions.get(session, version).robot_id
    archive = Archive(session, robot)
    fitted = {c: archive.count_fitted_rows(version, c) for c in named}
    files = {c for c in named if any(upload.sha256 in hashes for upload in campaigns.uploads_of_campaign(session, c))}
    shared = [c for c in named if c in files or fitted[c]]
    seen = [value for campaign in {one for one, _ in trained} for value in _temperatures(session, campaign)]
    made = drift.of_version(session, robot, version, named)
    repaired = repairs.last_repair(session, robot)  # since then the arm is another one: no check agreed with it yet
    good = [one for one in made if one.result.get("verdict") == "ok" and (repaired is None or one.at >= repaired.at)]
    dates = Dates(
        max(drift.measurement_times_and_digests(session, named)[0].values(), default=None),
        max((one.at for one in made), default=None),
        max(
            (at for at in (_stated_measurement_time(session, one) for one, _ in trained) if at is not None),
            default=None,
        ),
    )
    agreeing = tuple(one for one in good if dates.rows is None or one.at <= dates.rows)
    temperatures = (min(seen), max(seen)) if seen else None
    used = frozenset(name for name in (_instrument(session, one) for one, _ in trained) if name is not None)
    return FitOfVersion(temperatures, tuple(shared), agreeing, fitted, dates, used)


def _stated_measurement_time(session: Session, campaign: str) -> datetime | None:
    """When a campaign was measured, as somebody stated; None: nobody did, or it was purged."""
    try:
        return campaigns.get(session, campaign).measured_at
    except ServiceError:
        return None


def _instrument(session: Session, campaign: str) -> str | None:
    """What a campaign was measured with; None: it does not say, or was purged."""
    try:
        return campaigns.get(session, campaign).instrument
    except ServiceError:
        return None


def _temperatures(session: Session, campaign: str) -> Iterator[float]:
    """Temperatures of a campaign: its lowest and highest row, else what was stated for the whole; none of a purged one."""
    try:
        stated = campaigns.get(session, campaign).conditions.get("temperature_c")
    except ServiceError:
        return
    if any("temperature_c" in upload.columns for upload in campaigns.uploads_of_campaign(session, campaign)):
        column = campaigns.table(session, campaign).column("temperature_c").to_numpy(zero_copy_only=False)
        yield from (float(column.min()), float(column.max()))
    elif stated is not None:
        yield float(stated)
