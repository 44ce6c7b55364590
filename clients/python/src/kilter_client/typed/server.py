"""What the server answers about server, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kilter_client.results.record import Record


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Check(Record):
    """One thing that was looked at."""

    detail: str
    """What was found, in words."""
    ok: bool
    """Whether it is as it should be."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Health(Record):
    """The state of the server."""

    checks: Mapping[str, Check]
    """What was looked at, by name."""
    status: str
    """`live`: it answers; `ready`: it can do its work."""
    version: str
    """Release of the server."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JobError(Record):
    """Why a job failed."""

    code: str
    """Stable name of the error."""
    message: str
    """What is wrong, and what helps."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Progress(Record):
    """How far a job is (0 to 1) and what it does."""

    fraction: float
    """How far it is, 0 to 1."""
    stage: str
    """What it does now, in words."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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
