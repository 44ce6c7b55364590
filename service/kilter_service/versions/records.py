"""Versions and activations as they are stored, and what one would do."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_core.arm.robot import Robot

    Floats = NDArray[np.float64]


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
class Foreseen:
    """What a version would do, m and rad: movement of the tool, ``mean`` and ``largest``, with the joints (n,) there;
    ``joints (n,)`` the largest correction of each.
    """

    version_id: str
    robot: Robot
    poses: int
    corrected: int
    refused: dict[str, int]
    mean: float | None
    largest: float | None
    largest_at: Floats | None
    joints: Floats | None
    unsupported: list[str]
