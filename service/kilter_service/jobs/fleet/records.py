"""Fleet jobs as they are planned and stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.contract.jobs.job import NewJobOf


@dataclass(frozen=True)
class Planned:
    """What one robot is going to get: a job, or a refusal (its code and sentence). ``before`` is its active version."""

    robot_id: int
    before: str | None
    job: NewJobOf[IdentifyOptions] | None = None
    refusal: tuple[str, str] | None = None


@dataclass(frozen=True)
class FleetRobotRecord:
    """A robot of a fleet job, as it is stored with its job and version; ``state`` None: it was refused."""

    robot: str
    before_id: str | None
    refusal: Mapping[str, str] | None
    judged: Mapping[str, Any] | None
    job_id: str | None
    request: Mapping[str, Any] | None
    state: str | None
    error: Mapping[str, str] | None
    version_id: str | None


@dataclass(frozen=True)
class StateCount:
    """The jobs of a fleet job in one state (None: the robots without a job): how many, how far, and the last end."""

    state: str | None
    number: int
    fraction: float
    finished_at: datetime | None


@dataclass(frozen=True)
class FleetRecord:
    """A fleet job with the counts of its jobs."""

    id: str
    name: str
    created_at: datetime
    cancelled_at: datetime | None
    counts: Sequence[StateCount]
