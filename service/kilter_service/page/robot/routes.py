"""The first view of a robot, and the numbers of its picture."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, JSONResponse
from pydantic import ValidationError

from kilter_service.contract.drift import NewRepair
from kilter_service.contract.references import RobotChange
from kilter_service.contract.robots import MeshUnit
from kilter_service.contract.units import ControllerCompensation
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_MESH_MB
from kilter_service.page.robot import pose as asked_pose
from kilter_service.page.robot import scene, service
from kilter_service.page.robot import settings as settled
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.goals import parse_goals
from kilter_service.page.shared.take_step import take_step
from kilter_service.page.shell import get_root_path, is_part, redirect, render
from kilter_service.robots import service as robots
from kilter_service.robots.meshes import service as meshes
from kilter_service.robots.repairs import service as repairs
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import MESH, spool_upload
from kilter_service.web.concurrency import compute
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp, get_scratch

LONGEST = 200  # letters of what was done
LONGEST_DATE = 40


def parse_repair(what: str, at: str, **more: Any) -> NewRepair:
    """Read what was done or noted, and when, in UTC; an empty ``at`` is now.

    Raises:
        ServiceError: it does not say what was done, or the date is none.

    """
    if not what.strip():
        raise ServiceError("Say what was done, as: gear of joint 3 replaced.", code="payload_invalid", field="what")
    try:
        return NewRepair(what=what.strip(), at=_moment(at.strip()), **more)
    except ValidationError as error:
        told = "; ".join(f"{one['loc'][0]}: {one['msg']}" for one in error.errors())
        raise ServiceError(f"This cannot be noted: {told}.", code="payload_invalid") from error


def _moment(text: str) -> datetime | None:
    if not text:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise ServiceError(
            f"{text!r} is not a date and a time: give it as 2026-11-18T14:30, in UTC, or leave it empty for now.",
            code="payload_invalid",
            field="at",
        ) from None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found


router = APIRouter(include_in_schema=False, route_class=PageRoute)
BODY = {"requestBody": {"required": True}}  # the endpoint receives the file itself
ANEW = {"HX-Refresh": "true"}  # the picture is drawn anew too
ID = Annotated[str, Query(max_length=64)]


@router.get("/robots/{robot}")
def overview(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    version: ID = "",
    campaign: ID = "",
    other: ID = "",
) -> HTMLResponse:
    """Show how good a robot is, what corrects it, and what to do next."""
    shown = service.shown_robot(database, settings, robot, version or None, campaign or None, other)
    return render(request, "robot/overview.html", shown=shown)


@router.get("/robots/{robot}/state")
def state(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show how a robot stands, on each of its views."""
    return render(request, "robot/state.html", stands=service.standing(database, settings, robot))


@router.get("/robots/{robot}/settings")
def settings(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show what is rarely changed of a robot."""
    return render(request, "robot/settings.html", shown=settled.shown_settings(database, robot))


@router.post("/robots/{robot}/steps")
def queue_step(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    _: Admin,
    do: Annotated[str, Form(max_length=20)],
    campaign: Annotated[str, Form(max_length=64)] = "",
) -> Response:
    """Queue the job that comes next, with campaign and cause filled in."""
    job = take_step(database, robot, do, campaign)
    return redirect(request, f"{get_root_path(request)}/jobs/{job}")


@router.post("/robots/{robot}/goals")
def goals(
    robot: str,
    database: DatabaseOfApp,
    _: Admin,
    tolerance_mm: Annotated[str, Form(max_length=LONGEST_DATE)] = "",
    check_interval_days: Annotated[str, Form(max_length=LONGEST_DATE)] = "",
) -> Response:
    """Say how good the robot must be, and how often it is checked; what is left empty is not stated."""
    robots.change(database, robot, parse_goals(tolerance_mm, check_interval_days))
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/remarks")
def remarks(
    robot: str, database: DatabaseOfApp, _: Admin, remarks: Annotated[str, Form(max_length=20_000)] = ""
) -> Response:
    """Keep what people note on a robot."""
    robots.change(database, robot, RobotChange(remarks=remarks))
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/compensation")
def compensation(
    robot: str, database: DatabaseOfApp, _: Admin, compensation: Annotated[ControllerCompensation, Form()]
) -> Response:
    """Say whether the controller corrects by itself."""
    robots.change(database, robot, RobotChange(controller_compensation=compensation))
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/repairs")
def add_repair(
    robot: str,
    database: DatabaseOfApp,
    actor: Admin,
    what: Annotated[str, Form(max_length=LONGEST)] = "",
    at: Annotated[str, Form(max_length=LONGEST_DATE)] = "",
    kind: Annotated[str, Form(max_length=8)] = "repair",
    campaign: Annotated[str, Form(max_length=32)] = "",
    rows: Annotated[str, Form(max_length=LONGEST)] = "",
) -> Response:
    """Record what was done to an arm, or a note on a date, a campaign or its rows."""
    repairs.add(database, robot, parse_repair(what, at, kind=kind, campaign_id=campaign or None, rows=rows), actor)
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/repairs/{repair}/remove")
def remove_repair(robot: str, repair: str, database: DatabaseOfApp, _: Admin) -> Response:
    """Take back a repair that was recorded by mistake."""
    repairs.remove(database, robot, repair)
    return Response(status_code=204, headers=ANEW)


@router.get("/robots/{robot}/worst")
def worst(robot: str, request: Request, database: DatabaseOfApp, version: ID, campaign: ID) -> HTMLResponse:
    """Show the poses at which a version is worst."""
    scene.check(database, robot, version)
    found = scene.worst(database, version, campaign)
    return render(request, "robot/worst.html", found=found, version=version, campaign=campaign)


@router.get("/robots/{robot}/pose")
def pose(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    version: ID = "",
    other: ID = "",
    campaign: ID = "",
    row: Annotated[int, Query(ge=0, le=10**12)] = 0,
    q: Annotated[str, Query(max_length=1500)] = "",
) -> HTMLResponse:
    """Show what one or two versions say of a pose."""
    found = asked_pose.predict_by_versions(database, settings, robot, q, (version, other), campaign if row else "", row)
    template = "robot/pose_part.html" if is_part(request) else "robot/pose.html"
    return render(request, template, robot=robot, pose=found)


@router.get("/robots/{robot}/arm.json")
def arm(robot: str, database: DatabaseOfApp, version: ID = "") -> JSONResponse:
    """Send the chain, nominal and as a version has it."""
    if version:
        scene.check(database, robot, version)
    return JSONResponse(scene.arm(database, robot, version))


@router.get("/robots/{robot}/places.json")
def places(robot: str, database: DatabaseOfApp, version: ID, campaign: ID) -> JSONResponse:
    """Send the measured places with their errors."""
    scene.check(database, robot, version)
    return JSONResponse(scene.places(database, version, campaign))


@router.get("/robots/{robot}/reach.json")
def reach(robot: str, database: DatabaseOfApp, version: ID) -> JSONResponse:
    """Send correction and uncertainty all over the joint limits."""
    scene.check(database, robot, version)
    return JSONResponse(scene.reach(database, version))


@router.get("/robots/{robot}/meshes/{link}")
def mesh(robot: str, link: str, database: DatabaseOfApp) -> Response:
    """Send the triangles of a link."""
    return Response(scene.mesh(database, robot, link), media_type="application/octet-stream")


@router.post("/robots/{robot}/meshes/{link}", openapi_extra=BODY)
async def put_mesh(
    robot: str, link: str, request: Request, database: DatabaseOfApp, _: Admin, unit: MeshUnit = "mm", name: str = ""
) -> Response:
    """Give a link its shape, in place of the one it has."""
    form = meshes.form_of_name(name)
    await run_in_threadpool(meshes.check_link, database, robot, link)
    with get_scratch(request).folder_for("mesh") as folder:
        path = folder / "body"
        sha256 = await spool_upload(request, path, MAX_MESH_MB, MESH)
        await compute(request, meshes.put, database, robot, link, path, form, unit, sha256)
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/meshes/{link}/remove")
def remove_mesh(robot: str, link: str, database: DatabaseOfApp, _: Admin) -> Response:
    """Draw a link as cylinders again."""
    meshes.remove(database, robot, link)
    return Response(status_code=204, headers=ANEW)
