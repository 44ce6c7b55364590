"""What the server answers about evaluations, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from collections.abc import Mapping

from kilter_client.results.record import Record, Records
from kilter_client.results.shown_jobs import ShownEvaluation
from kilter_client.typed.cameras import LeftOpen
from kilter_client.typed.fits import Remark, StageErrors


class CampaignErrors(StageErrors):
    """Errors of several models on the rows of a campaign."""

    left_open: LeftOpen | None
    """Of views: how far off the tool may be at these poses by what the version's fit leaves open, which views hardly show. Null: not known, or something else tells where the tool is."""
    name: str | None
    """What the campaign was called; None: an earlier release did not say it."""
    within_u95: float | None
    """Share of the coordinates whose error is within its 95 % interval; None: nothing is known."""


class CriterionOfPose(Record):
    """A criterion of ISO 9283 at one pose."""

    abc_deg: tuple[float, ...]
    """The same of the orientation about x, y and z, degrees."""
    mm: float | None
    """The criterion at this pose, mm."""
    n: int | None
    """Cycles it rests on."""
    pose: int
    """Number of the pose, from 1."""
    ways: int | None
    """Directions the pose was reached from."""
    xyz_mm: tuple[float, ...]
    """Its coordinates, mm."""


class Criterion(Record):
    """A criterion of ISO 9283."""

    commanded_mm: float | None
    """Distance that was commanded, mm."""
    demands: int | None
    """Cycles that the standard demands."""
    mm: float | None
    """The criterion: the largest of all poses, mm."""
    n: int | None
    """Cycles it rests on."""
    points: int | None
    """Points of the path."""
    poses: Records[CriterionOfPose]
    """The criterion at each pose."""
    series_mm: tuple[float, ...]
    """The criterion of each series, mm, in time."""


class RefusedCriterion(Record):
    """A criterion that the rows do not support."""

    code: str
    """Stable name of the reason."""
    message: str
    """What is missing."""
    symbol: str
    """Symbol of the criterion."""


class Iso9283(Record):
    """Criteria of ISO 9283 of a campaign."""

    metrics: Mapping[str, Criterion]
    """Criteria by symbol."""
    refused: Records[RefusedCriterion]
    """Criteria that the rows do not support."""


class RowErrors(Record):
    """Errors of rows, measured minus predicted, as columns; of many rows 2000, evenly chosen."""

    dx_mm: tuple[float | None, ...]
    """Error along x, mm; None: nothing was seen."""
    dy_mm: tuple[float | None, ...]
    """Error along y, mm."""
    dz_mm: tuple[float | None, ...]
    """Error along z, mm."""
    pose: tuple[int, ...]
    """Pose of each row, from 1."""
    row: tuple[int, ...]
    """Rows of the campaign, from 1."""
    u95_x_mm: tuple[float | None, ...]
    """Half width of the 95 % interval along x, mm."""
    u95_y_mm: tuple[float | None, ...]
    """Half width of the 95 % interval along y, mm."""
    u95_z_mm: tuple[float | None, ...]
    """Half width of the 95 % interval along z, mm."""


class EvaluateResult(ShownEvaluation, Record):
    """How well a version predicts campaigns: errors, or criteria of ISO 9283."""

    iso9283: Mapping[str, Iso9283]
    """Criteria, by campaign."""
    metrics: Mapping[str, CampaignErrors]
    """Errors, by campaign."""
    refit: tuple[str, ...]
    """Frames that were refitted."""
    rows: Mapping[str, RowErrors]
    """Errors of the rows, by campaign."""
    standard: str | None
    """The standard, with its year."""
    version_id: str | None
    """The version that was evaluated; None: the nominal robot."""
    warnings: Records[Remark]
    """What to know before trusting the result."""
