"""What the server answers about jobs, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from kilter_client.results.record import Record
from kilter_client.typed.drifts import DriftResult, RezeroResult
from kilter_client.typed.evaluations import EvaluateResult
from kilter_client.typed.identifications import IdentifyResult, JointParametersResult
from kilter_client.typed.plans import PlanResult
from kilter_client.typed.searches import GapResult
from kilter_client.typed.server import JobError, Progress


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AnyJob(Record):
    """What every job has."""

    asked_by: str
    """Who asked for it: name of the token; empty: not noted by an earlier release."""
    attempts: int
    """How often a worker began it."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns it uses."""
    confirmation: tuple[str, ...]
    """Campaigns in which what it finds must be seen again."""
    created_at: str
    """When it was asked for."""
    error: JobError | None
    """Why it failed; None: it did not."""
    finished_at: str | None
    """When it was over; None: not yet."""
    id: str
    """Id of the job, `job_` and 16 hexadecimal digits."""
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
    validation: tuple[str, ...] | float | Mapping[str, Any] | None
    """What it holds out, as asked."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DriftJob(AnyJob):
    """A check of an arm with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: DriftResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EvaluateJob(AnyJob):
    """An evaluation with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: EvaluateResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GapJob(AnyJob):
    """A gap search with its options and its result."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: GapResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class IdentifyJob(AnyJob):
    """An identification with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: IdentifyResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointParametersJob(AnyJob):
    """A measurement of joints with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: JointParametersResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PlanJob(AnyJob):
    """A plan of poses with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: PlanResult | None
    """What came out; None: it has not succeeded."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RezeroJob(AnyJob):
    """A re-zeroing with what was asked and what came out."""

    kind: str
    """Kind of the job."""
    options: Mapping[str, Any]
    """Options, as asked."""
    result: RezeroResult | None
    """What came out; None: it has not succeeded."""
