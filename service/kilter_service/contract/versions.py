"""Parameter versions, their activation, and how two of them differ."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from kilter_service.contract.fits import Covariance, FitDetails, JointMotions, Metrics, NullDirection, Parameter
from kilter_service.contract.gap_details import MotionFound
from kilter_service.contract.headlines import HEADLINE, NEAR, count_noise_left, describe_fit, describe_masses
from kilter_service.contract.units import Celsius, Deg, Listed, Mm, Stored, Strict
from kilter_service.contract.wording import RETIRED_AT, TITLE, Remark

Lengths = list[Mm | None]


class ResidualRows(Strict):
    """What a version leaves of rows, measured minus predicted, as columns; every one has a value for each row."""

    campaign: list[str] = Field(description="Id of the row's campaign.")
    row: list[int] = Field(description="Number of the row in its campaign, from 1.")
    dx_mm: Lengths = Field(description="Error along x, mm, the mean of the markers; null: nothing was seen.")
    dy_mm: Lengths = Field(description="Error along y, mm.")
    dz_mm: Lengths = Field(description="Error along z, mm.")
    turn_deg: list[Deg | None] = Field(description="Error of the orientation, degrees; null: it was not measured.")
    residual_sigma: list[float | None] = Field(
        description="Length of what is left in standard deviations of a coordinate; rotations count too."
    )
    u95_x_mm: Lengths = Field(description="Half width of the 95 % interval that expects the error along x, mm.")
    u95_y_mm: Lengths = Field(description="Half width of the 95 % interval along y, mm.")
    u95_z_mm: Lengths = Field(description="Half width of the 95 % interval along z, mm.")
    set_aside: list[bool] = Field(description="Whether the identification set the row aside.")
    held_out: list[bool] = Field(description="Whether the row was held out of the fit.")


class PairedErrors(Strict):
    """What two versions leave of the same rows, base and tool as each version has them. Rows of one pose count once."""

    campaigns: list[str] = Field(description="Ids of the campaigns.")
    held_out: bool = Field(
        description="Whether the rows were held out of both fits; false: there were none, so fitted rows are among them."
    )
    rows: int = Field(description="Rows compared.")
    poses: int = Field(description="Poses compared.")
    counted: Literal["rows", "poses"] = Field(description="What is counted: `rows` where no pose was repeated.")
    better: int = Field(description="On how many b leaves less.")
    worse: int = Field(description="On how many it leaves more.")
    chance: Annotated[float, Field(ge=0, le=1)] = Field(
        description="Probability of so uneven a count if neither were better: exact sign test, two-sided."
    )
    mean_a_mm: Mm = Field(description="Mean error that a leaves, mm.")
    mean_b_mm: Mm = Field(description="Mean error that b leaves, mm.")
    less_mm: Mm = Field(description="How much less b leaves, mean over what is counted, mm; negative: more.")
    low_mm: Mm | None = Field(None, description="Lower end of its 95 % interval, mm; null: too few.")
    high_mm: Mm | None = Field(None, description="Upper end of its 95 % interval, mm; null: too few.")
    sentence: str = Field(description="The same in words, all lengths in one unit.")


class JointPreview(Strict):
    """The largest correction of a joint."""

    joint: str = Field(description="Name of the joint.")
    largest_deg: Deg | None = Field(
        None, description="Largest correction, degrees; null: prismatic, or nothing was corrected."
    )
    largest_mm: Mm | None = Field(None, description="Largest correction, mm; null: revolute, or nothing was corrected.")
    largest_at: list[float] | None = Field(None, description="The joints there: degrees, mm for prismatic ones.")


class VersionPreview(Strict):
    """How a version would correct, without activating it: what `correct` does with these poses, within its limits."""

    version_id: str = Field(description="Id of the version.")
    within: Literal["campaigns", "limits"] = Field(
        description="Poses looked at: `campaigns`, where the robot was driven before; `limits`, anywhere in its limits."
    )
    poses: int = Field(description="How many poses were looked at.")
    corrected: int = Field(description="How many of them get corrected joints, damped and limited ones among them.")
    damped: int = Field(
        0,
        description="How many of these keep more of their error than is stated: a singularity is near, or out of reach.",
    )
    limited: int = Field(
        0, description="How many of these keep more of their error than is stated because the correction is at a limit."
    )
    refused: dict[str, int] = Field(
        description="The others, by why they would be refused, such as `CORRECTION_TOO_LARGE` for its limits."
    )
    mean_mm: Mm | None = Field(
        description="Mean movement of the tool by the correction, mm; null: nothing was corrected."
    )
    largest_mm: Mm | None = Field(description="Largest movement of the tool by the correction, mm; null: as above.")
    largest_at: list[float] | None = Field(description="The joints there: degrees, mm for prismatic ones.")
    left_mm: Mm | None = Field(
        None, description="The most that a correction leaves of the tool's error by the version, mm; null: as above."
    )
    left_at: list[float] | None = Field(None, description="The joints there: degrees, mm for prismatic ones.")
    joints: list[JointPreview] = Field(description="The largest correction of each joint.")
    unsupported_effects: list[str] = Field(
        description="Ids of its effects that would not be corrected where rows state joints and loads alone, as in a stream."
    )
    corrected_where_stated: dict[str, list[str]] = Field(
        {},
        description="Those of them that rows of a file are corrected for, by id with the columns that rows must state.",
    )
    not_corrected: str = Field("", description="Both in words; empty: nothing is left out.")
    temperature_c: Celsius | None = Field(
        description="Temperature it was looked at with, degrees Celsius; null: not known."
    )


class CorrectionLimits(Strict):
    """The largest correction a version may make: a larger one is held there, or refused.

    Asked for with a job, a field that is left out comes from the version: what it needs, up to 5 degrees and 10 mm.
    """

    max_joint_deg: Annotated[Deg, Field(gt=0, le=30)] = Field(
        1.0, description="Largest correction of a joint, degrees, above 0 to 30."
    )
    max_position_mm: Annotated[Mm, Field(gt=0, le=200)] = Field(
        5.0, description="Largest correction of the tool, and of a prismatic joint, mm, above 0 to 200."
    )
    at_limit: Literal["saturate", "refuse"] = Field(
        "saturate",
        description="A correction that would be larger: `saturate` goes as far as the limit and says what is left, "
        "`refuse` refuses the setpoint.",
    )
    held_joints: Annotated[list[Annotated[int, Field(ge=1, le=64)]], Field(max_length=64)] = Field(
        [], description="Joints, from 1, that the correction leaves as they are: a rail, or a positioner."
    )


class UsedCampaign(Stored):
    """A campaign a version was made from, and the hashes of its uploads."""

    id: str = Field(description="Id of the campaign.")
    name: str = Field(description="Name of the campaign.")
    role: str = Field(description="What the campaign is meant for.")
    use: str = Field(description="What it was used for: `train`, `validation`, `confirmation` or `torques`.")
    rows: int = Field(description="Rows it had then.")
    sha256: list[str] = Field(description="SHA-256 of the files it had then.")


class VersionSummary(Strict):
    """A version in a list; metrics are those of the identification."""

    id: str = Field(description="Id of the version, `ver_` and 16 hexadecimal digits.")
    robot: str = Field(description="Name of its robot.")
    active: bool = Field(description="Whether the robot is corrected with it.")
    parent_id: str | None = Field(description="The version it was started from; null: the nominal robot.")
    job_id: str = Field(description="The job that made it.")
    created_at: datetime = Field(description="When it was made.")
    code_version: str = Field(description="Release of Kilter that made it.")
    effects: list[str] = Field(description="Ids of its effects.")
    metrics: Metrics = Field(description="Errors on the rows fitted and on those held out.")
    name: str = Field("", description=TITLE)
    notes: str = Field("", description="What people noted on it.")
    retired_at: datetime | None = Field(None, description=RETIRED_AT)
    torques: bool = Field(False, description="Whether it tells the torques of a path.")
    number: int = Field(
        0, description="Which version of its robot it is, from 1: `tour v2` names the second of `tour`."
    )


class ActivationWish(Strict):
    """How to activate a version: ``force`` in spite of what speaks against it. The log keeps ``reason``."""

    force: bool = Field(False, description="Activate it in spite of what speaks against it.")
    reason: Annotated[str, Field(max_length=500)] = Field("", description="Why, for the log; at most 500 characters.")


class Objection(Stored):
    """What speaks against activating a version."""

    code: str = Field(description="Stable name of the objection.")
    message: str = Field(description="What speaks against it, in words.")


class Rival(Strict):
    """What a version is compared with. It is worse when its error is larger by more than ``margin_mm``."""

    poses: int = Field(description="Poses compared.")
    mean_mm: Mm = Field(description="Mean error of the rival, mm.")
    larger_by_mm: Mm = Field(description="By how much the version's mean error is larger, mm; below 0: it is smaller.")
    margin_mm: Mm = Field(description="By how much it may be larger by chance, mm.")


class Comparison(Strict):
    """Mean errors on rows that no version compared was fitted to, base and tool refitted to each campaign.

    ``active`` is null when no version was active, or when it cannot predict these rows or was fitted to all of them.
    """

    rows: int = Field(description="Rows compared.")
    poses: int = Field(description="Poses they are at.")
    campaigns: list[str] = Field(description="Ids of the campaigns they are from.")
    campaign_names: list[str] = Field([], description="What these campaigns are called, in the same order.")
    mean_mm: Mm = Field(description="Mean error of the version, mm.")
    registration_only: Rival = Field(description="The nominal robot, base and tool fitted.")
    active_version: str | None = Field(description="The version that was active.")
    active: Rival | None = Field(description="The version that was active, on the rows it can be compared on.")


class ActivatedVersion(VersionSummary):
    """A version that corrects from now on; ``unsupported_effects`` are those that its stream does not correct.

    ``compared`` is null when there were no rows to compare on; ``warnings`` say why, and what else was left out.
    ``objections`` are what would have refused it without ``forced``. A roll-back is never compared.
    """

    unsupported_effects: list[str] = Field(
        description="Ids of its effects that are not corrected where rows state joints and loads alone, as in a stream."
    )
    corrected_where_stated: dict[str, list[str]] = Field(
        {},
        description="Those of them that rows of a file are corrected for, by id with the columns that rows must state.",
    )
    not_corrected: str = Field("", description="Both in words; empty: nothing is left out.")
    forced: bool = Field(False, description="Whether it was activated in spite of what speaks against it.")
    objections: list[Objection] = Field([], description="What would have refused it without `force`.")
    compared: Comparison | None = Field(None, description="How it was compared; null: there was nothing to compare on.")
    warnings: list[Remark] = Field([], description="What the comparison left out, and where it does not correct.")
    preview: VersionPreview | None = Field(
        None, description="What it does over the robot's poses; null: it was active before, or could not be computed."
    )


class Workspace(Stored):
    """What a version does at poses all over the joint limits, within its limits; why these are what they are."""

    sentence: str = Field(description="What the version needs, and the limits that follow from it, in words.")
    poses: int = Field(description="How many poses were looked at.")
    ok: int = Field(description="Poses corrected to within what is stated.")
    damped: int = Field(description="Poses that keep more of their error: a singularity is near, or out of reach.")
    limited: int = Field(description="Poses that keep more of their error: the correction is at a limit.")
    refused: dict[str, int] = Field(description="Poses that are refused, by why.")
    needed_deg: Deg | None = Field(
        description="Largest exact correction of a joint at 99 % of the poses, degrees; null: more poses have none."
    )
    needed_mm: Mm | None = Field(
        description="The same of the tool and of prismatic joints, mm; null: more poses have none."
    )
    reach_mm: Mm | None = Field(
        None, description="How far the tool can be from the base, all lengths in a row, mm; null: not stored."
    )


class Details(FitDetails):
    """What else the job of a version said. Which of it there is depends on the kind of job."""

    workspace: Workspace | None = Field(
        None,
        description="What it does all over the joint limits when it was stored, and why its limits are what they are.",
    )
    held_out_fraction: float | None = Field(None, description="Share of the poses a gap search held out by itself.")
    measured_by: str | None = Field(
        None, description="What joints were measured by: `inclinometer` or `link-side encoder`."
    )
    joints: list[JointMotions] | None = Field(None, description="What link-side encoders say of each joint.")
    torques_from: str | None = Field(
        None, description="Name of the search in torques whose model it holds; null: none."
    )
    motion: MotionFound | None = Field(None, description="What that search said, without the model.")


class Version(VersionSummary):
    """A version with all it holds; the covariance is SI, everything else in mm and degrees.

    ``objections`` are what its own identification says against activating it.
    ``details`` is what else its job said: method, observability, correlated groups, influence, intervals.
    """

    headline: str = Field("", description=HEADLINE)
    something_missing: bool = Field(False, description="Whether it leaves more than noise; a gap search looks for it.")
    sha256: str = Field(description="SHA-256 of what the version holds, 64 hexadecimal digits.")
    hash_scheme: Annotated[int, Field(ge=1, le=2)] = Field(
        description="What `sha256` covers: 1 calibration and limits, 2 the robot's chain too."
    )
    robot_sha256: str = Field(
        description="SHA-256 of the chain of the robot it was made on, 64 hexadecimal digits; empty: it could not be resolved."
    )
    campaigns: list[UsedCampaign] = Field(description="Campaigns it was made from.")
    limits: CorrectionLimits = Field(description="The largest correction it may make.")
    parameters: list[Parameter] = Field(description="Parameters that were identified.")
    null_directions: list[NullDirection] = Field(description="What the data could not tell.")
    noise_mm: Mm | None = Field(description="Standard deviation of a coordinate of the noise, mm.")
    warnings: list[Remark] = Field(description="What to know before trusting it.")
    objections: list[Objection] = Field([], description="What its own identification says against activating it.")
    details: Details = Field(description="What else its job said.")
    covariance: Covariance = Field(description="How well its parameters are known, SI.")

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline."""
        about = self.details
        said = describe_fit(self.metrics, self.parameters, self.noise_mm, about.noise, about.pixels)
        self.headline = said + describe_masses(about.masses_from, about.torques_from)
        self.something_missing = (count_noise_left(self.metrics, self.noise_mm, about.noise) or 0.0) > NEAR


class VersionList(Listed):
    """The versions of a robot, newest first."""

    versions: list[VersionSummary] = Field(description="Versions, newest first.")


class Activation(Strict):
    """An entry of the log of active versions; ``objections`` were overruled where it was ``forced``."""

    version_id: str = Field(description="The version that became active.")
    action: str = Field(description="`activate` or `rollback`.")
    actor: str = Field(description="Who did it.")
    at: datetime = Field(description="When.")
    forced: bool = Field(description="Whether it was forced.")
    reason: str = Field(description="Why, as it was given.")
    objections: list[Objection] = Field(description="What spoke against it.")


class ActivationList(Listed):
    """The log of active versions, newest first."""

    activations: list[Activation] = Field(description="Entries, newest first.")


class ParameterChange(Strict):
    """A parameter in two versions; null where a version does not have it."""

    name: str = Field(description="Name of the parameter; base and tool are whole frames, `base_x` ... `tool_rz`.")
    unit: str = Field(description="Unit of the numbers.")
    a: float | None = Field(description="Value in version a.")
    b: float | None = Field(description="Value in version b.")
    change: float | None = Field(description="b minus a.")
    sigma_a: float | None = Field(None, description="Standard deviation in version a; null: not known, or nominal.")
    sigma_b: float | None = Field(None, description="Standard deviation in version b; null: not known, or nominal.")
    moved: bool = Field(
        False, description="Whether they differ by more than 1.96 standard deviations of both, or only one has it."
    )


class VersionDiff(Strict):
    """What differs from version a to version b; either may be `nominal`, the nominal robot."""

    a: str = Field(description="Id of version a, or `nominal`.")
    b: str = Field(description="Id of version b, or `nominal`.")
    effects_added: list[str] = Field(description="Ids of effects that only b has.")
    effects_removed: list[str] = Field(description="Ids of effects that only a has.")
    parameters: list[ParameterChange] = Field(description="All parameters of both, and how they differ.")
    metrics_a: Metrics = Field(description="Errors of a.")
    metrics_b: Metrics = Field(description="Errors of b.")
    paired: PairedErrors | None = Field(
        None,
        description="What both leave of the same rows, held out of both where there are such; null: see `not_paired`.",
    )
    not_paired: str = Field("", description="Why rows are not compared, in words; empty: they are.")
