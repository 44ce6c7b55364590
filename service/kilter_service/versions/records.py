"""Versions and activations as they are stored, and what one would do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from kilter_core.types import Floats

ANSWERED = frozenset({"OK", "DAMPED", "LIMITED", "UNSURE"})  # verdicts on rows that have numbers


@dataclass(frozen=True)
class VersionRecord:
    """A stored version: core's calibration document and covariance in SI, the report of its job as it was written.

    ``sha256`` covers calibration and limits (``hash_scheme`` 1), and the robot's chain too (2).
    """

    id: str
    robot_id: int
    robot: str
    active: bool
    parent_id: str | None
    job_id: str
    created_at: datetime
    code_version: str
    sha256: str
    calibration: dict[str, Any]
    report: dict[str, Any]
    covariance: dict[str, Any]
    campaigns: list[dict[str, Any]]
    limits: dict[str, Any]
    hash_scheme: int
    robot_sha256: str
    name: str
    notes: str
    retired_at: datetime | None
    number: int


@dataclass(frozen=True)
class ActivationRecord:
    """An entry of the log of active versions; ``id`` grows from entry to entry."""

    id: int
    robot_id: int
    version_id: str
    action: str
    actor: str
    at: datetime
    forced: bool
    reason: str
    objections: list[dict[str, Any]]


@dataclass(frozen=True)
class PreviewedPoses:
    """What a version would do at N poses ``q (N, n)`` within its own limits, m and rad.

    ``words (N,)`` is the verdict on each pose, as in a corrected file: OK, DAMPED, LIMITED, or why it is refused.
    ``moved (N,)`` and ``left (N,)`` are how far the tool is moved and what is left of its error, NaN where refused;
    ``delta (N, n)`` the corrections of the joints. ``unsupported`` effects are left out, but for those in
    ``where_stated``: rows are corrected for them that state these quantities.
    """

    q: Floats
    words: tuple[str, ...]
    moved: Floats
    left: Floats
    delta: Floats
    unsupported: tuple[str, ...]
    where_stated: Mapping[str, tuple[str, ...]]

    @property
    def counts(self) -> dict[str, int]:
        """How many poses have which verdict."""
        return dict(Counter(self.words))

    @property
    def refusal_counts(self) -> dict[str, int]:
        """Poses that are refused, by why."""
        return {word: count for word, count in self.counts.items() if word not in ANSWERED}

    @property
    def corrected_count(self) -> int:
        """Poses that get numbers."""
        return len(self.words) - sum(self.refusal_counts.values())

    @property
    def furthest(self) -> int | None:
        """The pose whose tool is moved furthest; None: all are refused."""
        return largest(self.moved)

    @property
    def worst(self) -> int | None:
        """The pose at which most is left; None: all are refused."""
        return largest(self.left)

    @property
    def by_joint(self) -> list[int | None]:
        """For each joint the pose of its largest correction; None: all are refused."""
        return [largest(np.abs(column)) for column in self.delta.T]


def largest(sizes: Floats) -> int | None:
    """Return where the largest number is; None: there is none."""
    return None if np.isnan(sizes).all() else int(np.nanargmax(sizes))
