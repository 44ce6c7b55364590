"""What the server answers about versions, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import OfVersion, ShownActivated, ShownVersion
from kilter_client.typed.comparisons import Comparison
from kilter_client.typed.fits import Metrics, NullDirection, Objection, Parameter, Remark
from kilter_client.typed.identifications import AnyFit, JointMotions
from kilter_client.typed.previews import VersionPreview


class CorrectionLimits(Record):
    """The largest correction a version may make: a larger one is held there, or refused.

    Asked for with a job, a field that is left out comes from the version: what it needs, up to 5 degrees and 10 mm."""

    at_limit: str
    """A correction that would be larger: `saturate` goes as far as the limit and says what is left, `refuse` refuses the setpoint."""
    held_joints: tuple[int, ...]
    """Joints, from 1, that the correction leaves as they are: a rail, or a positioner."""
    max_joint_deg: float
    """Largest correction of a joint, degrees, above 0 to 30."""
    max_position_mm: float
    """Largest correction of the tool, and of a prismatic joint, mm, above 0 to 200."""


class Covariance(Record):
    """What a version knows of its parameters, SI; empty where nothing was identified."""

    freedom: float | None
    """Degrees of freedom of what the fit left, by which all of it is scaled; None: not known."""
    inadequacy_m: float | None
    """Standard deviation of a coordinate that the fit left beyond the noise, m."""
    inadequacy_rad: float | None
    """Standard deviation of a coordinate of the tool's rotation that a fit to views left beyond their noise, rad; None: not known."""
    matrix: tuple[tuple[float, ...], ...]
    """Covariance of the parameters, SI (m, rad, N m, ...)."""
    names: tuple[str, ...]
    """Names of the parameters, in the order of the matrix."""
    noise_m: float | None
    """Standard deviation of a coordinate of the noise, m."""
    noise_of: str | None
    """Kind of measurement whose noise that is, as `points`, `pixels` or `contacts`; None: not known. That of pixels and contacts is not taken for rows that an instrument measured."""
    units: str | None
    """`SI`."""


class Workspace(Record):
    """What a version does at poses all over the joint limits, within its limits; why these are what they are."""

    damped: int
    """Poses that keep more of their error: a singularity is near, or out of reach."""
    limited: int
    """Poses that keep more of their error: the correction is at a limit."""
    needed_deg: float | None
    """Largest exact correction of a joint at 99 % of the poses, degrees; None: more poses have none."""
    needed_mm: float | None
    """The same of the tool and of prismatic joints, mm; None: more poses have none."""
    ok: int
    """Poses corrected to within what is stated."""
    poses: int
    """How many poses were looked at."""
    reach_mm: float | None
    """How far the tool can be from the base, all lengths in a row, mm; None: not stored."""
    refused: Mapping[str, int]
    """Poses that are refused, by why."""
    sentence: str
    """What the version needs, and the limits that follow from it, in words."""


class Details(AnyFit):
    """What else the job of a version said. Which of it there is depends on the kind of job."""

    held_out_fraction: float | None
    """Share of the poses a gap search held out by itself."""
    joints: Records[JointMotions]
    """What link-side encoders say of each joint."""
    measured_by: str | None
    """What joints were measured by: `inclinometer` or `link-side encoder`."""
    workspace: Workspace | None
    """What it does all over the joint limits when it was stored, and why its limits are what they are."""


class UsedCampaign(Record):
    """A campaign a version was made from, and the hashes of its uploads."""

    id: str
    """Id of the campaign."""
    name: str
    """Name of the campaign."""
    role: str
    """What the campaign is meant for."""
    rows: int
    """Rows it had then."""
    sha256: tuple[str, ...]
    """SHA-256 of the files it had then."""
    use: str
    """What it was used for: `train`, `validation` or `confirmation`."""


class VersionSummary(OfVersion, Record):
    """A version in a list; metrics are those of the identification."""

    active: bool
    """Whether the robot is corrected with it."""
    code_version: str
    """Release of Kilter that made it."""
    created_at: str
    """When it was made."""
    effects: tuple[str, ...]
    """Ids of its effects."""
    id: str
    """Id of the version, `ver_` and 16 hexadecimal digits."""
    job_id: str
    """The job that made it."""
    metrics: Metrics
    """Errors on the rows fitted and on those held out."""
    name: str
    """What people call it, at most 200 characters; unique for its robot while it is in use."""
    notes: str
    """What people noted on it."""
    parent_id: str | None
    """The version it was started from; None: the nominal robot."""
    retired_at: str | None
    """Since when it is out of use; None: it is in use."""
    robot: str
    """Name of its robot."""


class Version(ShownVersion, VersionSummary):
    """A version with all it holds; the covariance is SI, everything else in mm and degrees.

    ``objections`` are what its own identification says against activating it.
    ``details`` is what else its job said: method, observability, correlated groups, influence, intervals."""

    active: bool
    """Whether the robot is corrected with it."""
    campaigns: Records[UsedCampaign]
    """Campaigns it was made from."""
    covariance: Covariance
    """How well its parameters are known, SI."""
    details: Details
    """What else its job said."""
    hash_scheme: int
    """What `sha256` covers: 1 calibration and limits, 2 the robot's chain too."""
    id: str
    """Id of the version, `ver_` and 16 hexadecimal digits."""
    limits: CorrectionLimits
    """The largest correction it may make."""
    metrics: Metrics
    """Errors on the rows fitted and on those held out."""
    name: str
    """What people call it, at most 200 characters; unique for its robot while it is in use."""
    noise_mm: float | None
    """Standard deviation of a coordinate of the noise, mm."""
    null_directions: Records[NullDirection]
    """What the data could not tell."""
    objections: Records[Objection]
    """What its own identification says against activating it."""
    parameters: Records[Parameter]
    """Parameters that were identified."""
    robot: str
    """Name of its robot."""
    robot_sha256: str
    """SHA-256 of the chain of the robot it was made on, 64 hexadecimal digits; empty: it could not be resolved."""
    sha256: str
    """SHA-256 of what the version holds, 64 hexadecimal digits."""
    warnings: Records[Remark]
    """What to know before trusting it."""


class ActivatedVersion(ShownActivated, VersionSummary):
    """A version that corrects from now on; ``unsupported_effects`` are those that its stream does not correct.

    ``compared`` is None when there were no rows to compare on; ``warnings`` say why, and what else was left out.
    ``objections`` are what would have refused it without ``forced``. A roll-back is never compared."""

    compared: Comparison | None
    """How it was compared; None: there was nothing to compare on."""
    corrected_where_stated: Mapping[str, tuple[str, ...]]
    """Those of them that rows of a file are corrected for, by id with the columns that rows must state."""
    forced: bool
    """Whether it was activated in spite of what speaks against it."""
    id: str
    """Id of the version, `ver_` and 16 hexadecimal digits."""
    not_corrected: str
    """Both in words; empty: nothing is left out."""
    objections: Records[Objection]
    """What would have refused it without `force`."""
    preview: VersionPreview | None
    """What it does over the robot's poses; None: it was active before, or could not be computed."""
    robot: str
    """Name of its robot."""
    unsupported_effects: tuple[str, ...]
    """Ids of its effects that are not corrected where rows state joints and loads alone, as in a stream."""
    warnings: Records[Remark]
    """What the comparison left out, and where it does not correct."""


class Activation(Record):
    """An entry of the log of active versions; ``objections`` were overruled where it was ``forced``."""

    action: str
    """`activate` or `rollback`."""
    actor: str
    """Who did it."""
    at: str
    """When."""
    forced: bool
    """Whether it was forced."""
    objections: Records[Objection]
    """What spoke against it."""
    reason: str
    """Why, as it was given."""
    version_id: str
    """The version that became active."""
