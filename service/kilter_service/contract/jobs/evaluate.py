"""Jobs of kind ``evaluate``: any version against any campaign."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field

from kilter_service.contract.devices import LeftOpen
from kilter_service.contract.fits import StageErrors
from kilter_service.contract.headlines import HEADLINE, MOST_NAMED, number
from kilter_service.contract.jobs.check import NewFrames, Version
from kilter_service.contract.jobs.kind import JobContract, JobOf
from kilter_service.contract.units import Asked, Deg, Mm, Stored
from kilter_service.contract.wording import Remark

Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "AT", "RT", "dAP", "dRP"]


class EvaluateOptions(Asked):
    """What can be asked of an evaluation."""

    version: Version = Field(None, description="Id of the version; null: the active one, else the nominal robot.")
    refit: NewFrames = Field(
        [],
        description='Frames refitted to these rows: [], ["base"] or ["base", "tool"] (the tracker was set up again).',
    )
    metrics: Literal["errors", "iso9283"] = Field("errors", description="Errors, or the criteria of ISO 9283.")
    criteria: Annotated[list[Symbol], Field(max_length=9)] = Field(
        [], description="Criteria of ISO 9283 that must be given; empty: all that the rows support."
    )


class CampaignErrors(StageErrors):
    """Errors of several models on the rows of a campaign."""

    name: str | None = Field(None, description="What the campaign was called; null: an earlier release did not say it.")
    within_u95: float | None = Field(
        None, description="Share of the coordinates whose error is within its 95 % interval; null: nothing is known."
    )
    left_open: LeftOpen | None = Field(
        None,
        description="Of views: how far off the tool may be at these poses by what the version's fit leaves open, which views "
        "hardly show. Null: not known, or something else tells where the tool is.",
    )


class RowErrors(Stored):
    """Errors of rows, measured minus predicted, as columns; of many rows 2000, evenly chosen."""

    row: list[int] = Field(description="Rows of the campaign, from 1.")
    pose: list[int] | None = Field(None, description="Pose of each row, from 1.")
    dx_mm: list[Mm | None] | None = Field(None, description="Error along x, mm; null: nothing was seen.")
    dy_mm: list[Mm | None] | None = Field(None, description="Error along y, mm.")
    dz_mm: list[Mm | None] | None = Field(None, description="Error along z, mm.")
    u95_x_mm: list[Mm | None] | None = Field(None, description="Half width of the 95 % interval along x, mm.")
    u95_y_mm: list[Mm | None] | None = Field(None, description="Half width of the 95 % interval along y, mm.")
    u95_z_mm: list[Mm | None] | None = Field(None, description="Half width of the 95 % interval along z, mm.")


class CriterionOfPose(Stored):
    """A criterion of ISO 9283 at one pose."""

    pose: int = Field(description="Number of the pose, from 1.")
    n: int | None = Field(None, description="Cycles it rests on.")
    ways: int | None = Field(None, description="Directions the pose was reached from.")
    mm: Mm | None = Field(None, description="The criterion at this pose, mm.")
    xyz_mm: list[Mm] | None = Field(None, description="Its coordinates, mm.")
    abc_deg: list[Deg] | None = Field(None, description="The same of the orientation about x, y and z, degrees.")


class Criterion(Stored):
    """A criterion of ISO 9283."""

    mm: Mm | None = Field(None, description="The criterion: the largest of all poses, mm.")
    n: int | None = Field(None, description="Cycles it rests on.")
    demands: int | None = Field(None, description="Cycles that the standard demands.")
    points: int | None = Field(None, description="Points of the path.")
    commanded_mm: Mm | None = Field(None, description="Distance that was commanded, mm.")
    series_mm: list[Mm] | None = Field(None, description="The criterion of each series, mm, in time.")
    poses: list[CriterionOfPose] | None = Field(None, description="The criterion at each pose.")


class RefusedCriterion(Stored):
    """A criterion that the rows do not support."""

    symbol: str = Field(description="Symbol of the criterion.")
    code: str = Field(description="Stable name of the reason.")
    message: str = Field(description="What is missing.")


class Iso9283(Stored):
    """Criteria of ISO 9283 of a campaign."""

    metrics: dict[str, Criterion] | None = Field(None, description="Criteria by symbol.")
    refused: list[RefusedCriterion] | None = Field(None, description="Criteria that the rows do not support.")


class EvaluateResult(Stored):
    """How well a version predicts campaigns: errors, or criteria of ISO 9283."""

    version_id: str | None = Field(None, description="The version that was evaluated; null: the nominal robot.")
    refit: list[str] | None = Field(None, description="Frames that were refitted.")
    metrics: dict[str, CampaignErrors] | None = Field(None, description="Errors, by campaign.")
    rows: dict[str, RowErrors] | None = Field(None, description="Errors of the rows, by campaign.")
    warnings: list[Remark] | None = Field(None, description="What to know before trusting the result.")
    standard: str | None = Field(None, description="The standard, with its year.")
    iso9283: dict[str, Iso9283] | None = Field(None, description="Criteria, by campaign.")
    headline: str | None = Field(None, description=HEADLINE)

    def model_post_init(self, context: Any, /) -> None:
        """Add the headline, to results of earlier releases too."""
        if self.metrics or self.iso9283:
            errors = (_describe_errors(one.name or key, one) for key, one in (self.metrics or {}).items())
            criteria = (_describe_criteria(one) for one in (self.iso9283 or {}).values())
            self.headline = "\n".join([line for line in (*errors, *criteria) if line][:MOST_NAMED]) or None


def _describe_errors(name: str, one: CampaignErrors) -> str:
    before = one.registration_only or one.nominal
    after = one.identified or before
    if before is None or after is None:
        return ""
    aside = f" ({one.left_out} more set aside)" if one.left_out else ""
    fell = "" if after is before else f"{number(before.mean_mm)} -> "
    fitted = " Before: nominal arm, base and tool fitted." if one.registration_only is not None else ""
    return f"Mean error on {one.n} rows of {name}{aside}: {fell}{number(after.mean_mm)} mm.{fitted}"


def _describe_criteria(report: Iso9283) -> str:
    found = [f"{symbol} {number(one.mm)} mm" for symbol, one in (report.metrics or {}).items() if one.mm is not None]
    return f"ISO 9283: {', '.join(found)}." if found else ""


EVALUATE = JobContract(
    "evaluate",
    noun="evaluation",
    title="Evaluate a version",
    summary="Compare a version with campaigns.",
    options=EvaluateOptions,
    result=EvaluateResult,
    seconds=(0.5, 0.1, 5.0),
    version_option="version",
    takes_folds=True,
    against_fit=True,
    usual=("version", "refit", "metrics"),
    uses={"validation": "train"},
)
EvaluateJob: TypeAlias = JobOf[EvaluateOptions, EvaluateResult]
