"""What the server answers about jobs, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.typed.drifts import DriftResult, RezeroResult
from kilter_client.typed.evaluations import EvaluateResult
from kilter_client.typed.identifications import IdentifyResult, JointParametersResult
from kilter_client.typed.plans import PlanResult
from kilter_client.typed.searches import GapResult
from kilter_client.typed.server import JobSummary


class AnyJob(JobSummary):
    """What every job has."""

    attempts: int
    """How often a worker began it."""
    campaigns: tuple[str, ...]
    """Ids of the campaigns it uses."""
    confirmation: tuple[str, ...]
    """Campaigns in which what it finds must be seen again."""
    options: Mapping[str, Any]
    """Options, as asked."""
    validation: tuple[str, ...] | float | Mapping[str, Any] | None
    """What it holds out, as asked."""


class DriftJob(AnyJob):
    """A check of an arm with what was asked and what came out."""

    result: DriftResult | None
    """What came out; None: it has not succeeded."""


class EvaluateJob(AnyJob):
    """An evaluation with what was asked and what came out."""

    result: EvaluateResult | None
    """What came out; None: it has not succeeded."""


class GapJob(AnyJob):
    """A gap search with what was asked and what came out."""

    result: GapResult | None
    """What came out; None: it has not succeeded."""


class IdentifyJob(AnyJob):
    """An identification with what was asked and what came out."""

    result: IdentifyResult | None
    """What came out; None: it has not succeeded."""


class JointParametersJob(AnyJob):
    """A measurement of joints with what was asked and what came out."""

    result: JointParametersResult | None
    """What came out; None: it has not succeeded."""


class PlanJob(AnyJob):
    """A plan of poses with what was asked and what came out."""

    result: PlanResult | None
    """What came out; None: it has not succeeded."""


class RezeroJob(AnyJob):
    """A re-zeroing with what was asked and what came out."""

    result: RezeroResult | None
    """What came out; None: it has not succeeded."""
