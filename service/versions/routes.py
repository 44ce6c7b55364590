"""Versions over HTTP."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Response

from service.auth.access import Admin
from service.routing import GuardedRoute
from service.slots import reading_turn
from service.state import DatabaseOfApp, SettingsOfApp
from service.versions import activation, service
from service.versions.schemas import ActivatedVersion, ActivationList, ActivationWish, Version, VersionDiff, VersionList

router = APIRouter(prefix="/v1", tags=["versions"], route_class=GuardedRoute)


@router.get("/robots/{robot}/versions")
def listed(robot: str, database: DatabaseOfApp) -> VersionList:
    """List the versions of a robot, newest first."""
    return service.listed(database, robot)


@router.get("/robots/{robot}/activations")
def activations(robot: str, database: DatabaseOfApp) -> ActivationList:
    """Show who activated which version, and when."""
    return service.activations(database, robot)


@router.post("/robots/{robot}/rollback")
def rollback(robot: str, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin) -> ActivatedVersion:
    """Return to the version that was active before; says which of its effects are not corrected at run time."""
    return activation.rollback(database, robot, actor, settings.temperature_c)


@router.get("/versions/{version}")
def get(version: str, database: DatabaseOfApp) -> Version:
    """Show a version with all it holds."""
    return service.get(database, version)


@router.post("/versions/{version}/activate")
def activate(
    version: str,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    actor: Admin,
    wish: ActivationWish | None = None,
) -> ActivatedVersion:
    """Correct the robot with this version from now on, unless it predicts worse than what it takes the place of.

    It is compared on poses that neither it nor the active version was fitted to. `force` activates it all the same. Says
    which of its effects are not corrected at run time.
    """
    return activation.activate(database, version, actor, wish or ActivationWish(), settings.temperature_c)


@router.get("/versions/{a}/diff/{b}", dependencies=[Depends(reading_turn)])
def diff(a: str, b: str, database: DatabaseOfApp) -> VersionDiff:
    """Compare two versions of one robot."""
    return service.diff(database, a, b)


@router.get("/versions/{version}/export", response_class=Response, dependencies=[Depends(reading_turn)])
def export(version: str, database: DatabaseOfApp, format: str = "json") -> Response:  # noqa: A002 (the contract's name)
    """Download a version in the format of another tool; the header Kilter-Notes says what the file leaves out."""
    file = service.exported(database, version, format)
    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers["Kilter-Notes"] = " | ".join(file.notes)
    return Response(file.text, media_type=file.media_type, headers=headers)
