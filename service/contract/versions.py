"""Parameter versions, their activation, and how two of them differ."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import Field

from service.contract.references import Notes, RetiredAt, Title
from service.contract.units import Strict


class CorrectionLimits(Strict):
    """The largest correction a version may make; anything larger is refused, not clipped."""

    max_joint_deg: Annotated[float, Field(gt=0, le=30)] = 1.0
    max_position_mm: Annotated[float, Field(gt=0, le=200)] = 5.0


class UsedCampaign(Strict):
    """A campaign a version was made from, and the hashes of its uploads."""

    id: str
    name: str
    role: str
    use: str
    rows: int
    sha256: list[str]


class VersionSummary(Strict):
    """A version in a list; metrics are those of the identification."""

    id: str
    robot: str
    active: bool
    parent_id: str | None
    job_id: str
    created_at: datetime
    code_version: str
    effects: list[str]
    metrics: dict[str, Any]
    name: Title = ""
    notes: Notes = ""
    retired_at: RetiredAt = None


class ActivationWish(Strict):
    """How to activate a version: ``force`` in spite of what speaks against it. The log keeps ``reason``."""

    force: bool = False
    reason: Annotated[str, Field(max_length=500)] = ""


class Objection(Strict):
    """What speaks against activating a version."""

    code: str
    message: str


class Rival(Strict):
    """What a version is compared with. It is worse when its error is larger by more than ``margin_mm``."""

    poses: int
    mean_mm: float
    larger_by_mm: float
    margin_mm: float


class Comparison(Strict):
    """Mean errors on rows that no version compared was fitted to, base and tool fitted anew to each campaign.

    ``active`` is null when no version was active, or when it cannot predict these rows or was fitted to all of them.
    """

    rows: int
    poses: int
    campaigns: list[str]
    mean_mm: float
    registration_only: Rival
    active_version: str | None
    active: Rival | None


class ActivatedVersion(VersionSummary):
    """A version that corrects from now on; ``unsupported_effects`` are those it does not correct at run time.

    ``compared`` is null when there were no rows to compare on; ``warnings`` say why, and what else was left out.
    ``objections`` are what would have refused it without ``forced``. A roll-back is never compared.
    """

    unsupported_effects: list[str]
    forced: bool = False
    objections: list[Objection] = []
    compared: Comparison | None = None
    warnings: list[dict[str, Any]] = []


class Version(VersionSummary):
    """A version with all it holds; the covariance is SI, everything else in mm and degrees.

    ``objections`` are what its own identification says against activating it.
    ``details`` is what else its job said: method, observability, correlated groups, influence, intervals.
    """

    sha256: str
    hash_scheme: Annotated[
        int, Field(description="What `sha256` covers: 1 calibration and limits, 2 the robot's chain too", ge=1, le=2)
    ]
    robot_sha256: Annotated[str, Field(description="SHA-256 of the chain of the robot that the version was made on")]
    campaigns: list[UsedCampaign]
    limits: CorrectionLimits
    parameters: list[dict[str, Any]]
    null_directions: list[dict[str, Any]]
    noise_mm: float | None
    warnings: list[dict[str, Any]]
    objections: list[Objection] = []
    details: dict[str, Any]
    covariance: dict[str, Any]


class VersionList(Strict):
    """The versions of a robot, newest first."""

    versions: list[VersionSummary]


class Activation(Strict):
    """An entry of the log of active versions; ``objections`` were overruled where it was ``forced``."""

    version_id: str
    action: str
    actor: str
    at: datetime
    forced: bool
    reason: str
    objections: list[Objection]


class ActivationList(Strict):
    """The log of active versions, newest first."""

    activations: list[Activation]


class ParameterChange(Strict):
    """A parameter in two versions; null where a version does not have it."""

    name: str
    unit: str
    a: float | None
    b: float | None
    change: float | None


class VersionDiff(Strict):
    """What differs from version a to version b."""

    a: str
    b: str
    effects_added: list[str]
    effects_removed: list[str]
    parameters: list[ParameterChange]
    metrics_a: dict[str, Any]
    metrics_b: dict[str, Any]
