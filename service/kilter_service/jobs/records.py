"""Jobs as they are stored."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple


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
