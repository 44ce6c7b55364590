"""Versions over HTTP."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response

from kilter_service.contract.references import Change, Tombstone
from kilter_service.contract.units import MAX_NAMED
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
from kilter_service.ground.tables.reading import CSV, JSON, PARQUET
from kilter_service.robots.exporters.registry import FORMATS
from kilter_service.versions import activation, service
from kilter_service.versions.addressed import AddressedVersion, FirstVersion, SecondVersion
from kilter_service.versions.if_match import ExpectedState, tag_of_robot
from kilter_service.versions.predictions import differences
from kilter_service.versions.predictions import preview as previews
from kilter_service.versions.predictions import residuals as left
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp, PageOfList, SettingsOfApp

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
