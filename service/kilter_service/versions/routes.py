"""Versions, checks, today, metrics and decisions about a tolerance over HTTP."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from kilter_service.contract.today import Acceptance, DriftHistory, DriftList, Today
from kilter_service.contract.units import MAX_NAMED, Name
from kilter_service.contract.versions import (
    ActivatedVersion,
    ActivationList,
    ActivationWish,
    ResidualRows,
    Version,
    VersionDiff,
    VersionList,
    VersionPreview,
)
from kilter_service.contract.wording import Change, Tombstone
from kilter_service.ground.tables.reading import CSV, JSON, PARQUET
from kilter_service.robots.exporters.registry import FORMATS
from kilter_service.versions import acceptance as acceptance_service
from kilter_service.versions import activation, service
from kilter_service.versions import metrics as metrics_service
from kilter_service.versions.acceptance import Wish
from kilter_service.versions.drift import service as drift_service
from kilter_service.versions.if_match import AddressedVersion, ExpectedState, FirstVersion, SecondVersion, tag_of_robot
from kilter_service.versions.predictions import at_pose as previews
from kilter_service.versions.predictions import differences
from kilter_service.versions.predictions import unfitted_rows as left
from kilter_service.versions.today import service as today_service
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import ConditionalRoute, DatabaseOfApp, GuardedRoute, PageOfList, SettingsOfApp

FILE = {"schema": {"type": "string", "format": "binary"}}
EXPORTS = {form.media_type: FILE for form in FORMATS.values()} | {JSON: {"schema": {"type": "object"}}}

router = APIRouter(prefix="/v1", tags=["versions"], route_class=ConditionalRoute)


@router.get("/robots/{robot}/versions")
def listed(robot: str, database: DatabaseOfApp, page: PageOfList, retired: bool = False) -> VersionList:
    """List the versions of a robot, newest first; with `retired` also those that are out of use."""
    return service.list_versions(database, robot, page, retired)


@router.get("/robots/{robot}/activations")
def activations(robot: str, database: DatabaseOfApp, page: PageOfList, response: Response) -> ActivationList:
    """Show who activated which version, and when. The ETag is that of the active version, for `If-Match`."""
    response.headers["ETag"] = tag_of_robot(database, robot)
    return service.activations(database, robot, page)


@router.post("/robots/{robot}/rollback")
def rollback(
    robot: str,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    response: Response,
    expected: ExpectedState,
    actor: Admin,
) -> ActivatedVersion:
    """Return to the version that was active before; says which of its effects are not corrected at run time."""
    done = activation.rollback(database, robot, actor, settings.temperature_c, expected)
    response.headers["ETag"] = tag_of_robot(database, robot)
    return done


@router.get("/versions/{version}")
def get(version: AddressedVersion, database: DatabaseOfApp) -> Version:
    """Show a version with all it holds."""
    return service.get(database, version)


@router.patch("/versions/{version}")
def change(version: AddressedVersion, wanted: Change, database: DatabaseOfApp, _: Admin) -> Version:
    """Name a version, or note something on it; what it holds stays as it is."""
    return service.change(database, version, wanted)


@router.post("/versions/{version}/retire")
def retire(version: AddressedVersion, database: DatabaseOfApp, actor: Admin) -> Version:
    """Take a version out of use; the active one cannot be."""
    return service.retire(database, version, actor)


@router.post("/versions/{version}/restore")
def restore(version: AddressedVersion, database: DatabaseOfApp, _: Admin) -> Version:
    """Bring a retired version back into use."""
    return service.restore(database, version)


@router.post("/versions/{version}/purge")
def purge(version: AddressedVersion, database: DatabaseOfApp, actor: Admin) -> Tombstone:
    """Delete a version that nothing cites, for good; its hash is kept."""
    return service.purge(database, version, actor)


@router.post("/versions/{version}/activate")
def activate(
    version: AddressedVersion,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    response: Response,
    expected: ExpectedState,
    actor: Admin,
    wish: ActivationWish | None = None,
) -> ActivatedVersion:
    """Correct the robot with this version from now on, unless it predicts worse than what it replaces.

    It is compared on poses that neither it nor the active version was fitted to. `force` activates it all the same. Says
    which of its effects are not corrected at run time.
    """
    done = activation.activate(database, version, actor, wish or ActivationWish(), settings.temperature_c, expected)
    response.headers["ETag"] = tag_of_robot(database, done.robot)
    return done


@router.get("/versions/{version}/preview")
def preview(version: AddressedVersion, database: DatabaseOfApp, settings: SettingsOfApp) -> VersionPreview:
    """Say how a version would correct, without activating it: its largest correction, where, and what it leaves out.

    The poses are those that the robot was driven to in its campaigns, else poses drawn within its limits.
    """
    return previews.preview(database, version, settings.temperature_c)


@router.get("/versions/{a}/diff/{b}")
def diff(
    a: FirstVersion,
    b: SecondVersion,
    database: DatabaseOfApp,
    campaign: Annotated[list[str] | None, Query(max_length=MAX_NAMED)] = None,
) -> VersionDiff:
    """Compare two versions of one robot, or one with `nominal`: the nominal robot, the effects at zero.

    The id of a job stands for the version that it made. What both leave is compared on rows held out of both fits, of the
    campaigns named or of all that either was made from.
    """
    return differences.diff(database, a, b, campaign or [])


@router.get(
    "/versions/{version}/residuals",
    response_class=Response,
    responses={
        200: {
            "model": ResidualRows,
            "content": {CSV: FILE, PARQUET: FILE},
            "description": "One line per row, or columns",
        }
    },
)
def residuals(
    version: AddressedVersion,
    database: DatabaseOfApp,
    campaign: Annotated[list[str] | None, Query(max_length=MAX_NAMED)] = None,
    format: Literal["csv", "parquet", "json"] = "csv",  # noqa: A002 (the name of the export's parameter)
) -> Response:
    """Download what a version leaves of every row, of all campaigns it was made from or of those named.

    Each line has the campaign and the row in it, the error measured minus predicted, its length in standard deviations,
    half the 95 % interval that expects it, whether the row was set aside, and whether it was held out of the fit. Views
    have the error of the tool that explains them best, without the noise of their corners, and no interval.
    """
    media = {"csv": CSV, "parquet": PARQUET, "json": JSON}[format]
    content = left.residuals(database, version, campaign or [], media)
    headers = {"Content-Disposition": f'attachment; filename="{version}-residuals.{format}"'}
    return Response(content, media_type=media, headers=headers)


@router.get(
    "/versions/{version}/export",
    response_class=Response,
    responses={200: {"content": EXPORTS, "description": "The file"}},
)
def export(
    version: AddressedVersion,
    database: DatabaseOfApp,
    format: str = "json",  # noqa: A002 (the contract's name)
    ranges: Annotated[float, Query(gt=0.0, lt=100.0, description="With format ranges: what they cover, %.")] = 95.0,
) -> Response:
    """Download a version in the format of another tool; the header Kilter-Notes says what the file leaves out.

    Format `ranges` says how far the arm may be from the version: ranges of its parameters and 100 draws of all together,
    to train with; of other arms of the type too, where versions of five are known.
    """
    file = service.export_version(database, version, format, ranges)
    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers["Kilter-Notes"] = " | ".join(file.notes)
    return Response(file.text, media_type=file.media_type, headers=headers)


drift_router = APIRouter(prefix="/v1", tags=["robots"], route_class=ConditionalRoute)


@drift_router.get("/robots/{robot}/drift")
def drift(robot: str, database: DatabaseOfApp) -> DriftHistory:
    """Return the checks of a robot, the control charts of its active version, and how it stands by them."""
    return drift_service.of_robot(database, robot)


@drift_router.get("/drift")
def drifts(database: DatabaseOfApp) -> DriftList:
    """Return how all robots stand by their checks, the worst first."""
    return drift_service.of_robots(database)


today_router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)


@today_router.get("/{robot}/today")
def today(robot: str, database: DatabaseOfApp) -> Today:
    """Say how good a robot is today: its newest error on rows that no fit used, and what is missing."""
    return today_service.of_robot(database, robot)


metrics_router = APIRouter(tags=["health"], route_class=GuardedRoute)
TEXT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Metrics"}
}


@metrics_router.get("/metrics", response_class=Response, responses=TEXT)
def metrics(database: DatabaseOfApp, settings: SettingsOfApp) -> Response:
    """Return the metrics of this process and of the database, in the text format of Prometheus."""
    return Response(metrics_service.text(database, settings), headers={"Content-Type": metrics_service.MEDIA_TYPE})


acceptance_router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)
LARGEST_MM = 1000.0
Refit = Literal["none", "base", "base,tool"]
REFITS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "base,tool": ("base", "tool")}
ToleranceMm = Annotated[
    float,
    Query(
        gt=0,
        le=LARGEST_MM,
        description="Tolerance of the position of the tool, mm.",
        json_schema_extra={"x-unit": "mm"},
    ),
]
Campaigns = Annotated[
    list[str] | None,
    Query(description="Ids of campaigns; none: those of today's number, else all.", max_length=MAX_NAMED),
]


@acceptance_router.get("/{robot}/acceptance")
def acceptance(
    robot: str,
    database: DatabaseOfApp,
    tolerance_mm: ToleranceMm,
    version: Annotated[str | None, Query(description="The version; none: the active one.", max_length=64)] = None,
    campaign: Campaigns = None,
    refit: Annotated[
        Refit | None,
        Query(description="Frames to fit to the rows of each campaign; none given: as today's number does."),
    ] = None,
    instrument: Annotated[Name | None, Query(description="Instrument of campaigns that name none.")] = None,
) -> Acceptance:
    """Decide by ISO 14253-1 whether a robot keeps a tolerance, on rows that its version was not fitted to."""
    wish = Wish(tolerance_mm, version, campaign or (), None if refit is None else REFITS[refit], instrument)
    return acceptance_service.of_robot(database, robot, wish)
