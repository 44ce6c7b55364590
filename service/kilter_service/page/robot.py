"""The first view of a robot, its settings, and the view in which a path is corrected."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Form, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, JSONResponse
from pydantic import ValidationError

from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns import suspicious
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.gap import GAP, GapResult
from kilter_service.contract.robot_reports import RobotReport
from kilter_service.contract.robots import MeshUnit
from kilter_service.contract.today import NewRepair, Today
from kilter_service.contract.units import ControllerCompensation
from kilter_service.contract.versions import Version, VersionSummary
from kilter_service.contract.wording import RobotChange
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_MESH_MB, MAX_TRIANGLES
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.jobs import service as jobs
from kilter_service.page import scene
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.shared.asking import parse_goals, take_step
from kilter_service.page.shared.control_chart import draw_check_history
from kilter_service.page.shared.standing import (
    Correcting,
    accuracy_today,
    assess_robot_state,
    corrector,
    error_budget,
)
from kilter_service.page.words import validation_words
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import WORDS
from kilter_service.robots.meshes import service as meshes
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import MESH, compute, spool_upload
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp, get_scratch

NEWEST = Page(limit=50)


def shown_robot(
    database: Database, settings: Settings, name: str, version: str, campaign: str, other: str
) -> dict[str, Any]:
    """Return what the overview shows; ``version``, ``other`` and ``campaign`` are of the picture, where they were chosen.

    ``candidate`` is a newer version that is not active, ``earlier`` whether there is an activation to go back to, ``unseen``
    the number of parameters that the measurements of the active version could not tell.
    """
    robot, now = robots.get(database, name), today.of_robot(database, name)
    active = None if robot.active_version is None else versions.get(database, robot.active_version)
    log = versions.activations(database, name, Page(limit=2)).activations
    made = versions.list_versions(database, name, NEWEST).versions
    measured = [one for one in campaigns.list_campaigns(database, name, Page()).campaigns if one.rows]
    beside = _version(database, name, made, other)
    looked_at = _version(database, name, made, version) or active or (made[0] if made else None)
    older = {one.id: one for one in (active, looked_at, beside) if one is not None}
    correcting = _correction(database, settings, robot)
    return {
        "robot": robot,
        "today": now,
        "state": assess_robot_state(now, correcting),
        "version": active,
        "accuracy": accuracy_today(now),
        "activation": log[0] if log else None,
        "earlier": len(log) > 1,
        "candidate": made[0] if made and not made[0].active else None,
        "correcting": correcting,
        "campaigns": measured,
        "versions": [*made, *(one for key, one in older.items() if key not in {each.id for each in made})],
        "looked_at": looked_at,
        "other": beside,
        "campaign": _campaign(database, measured, looked_at, campaign, now),
        "watched": draw_check_history(drift.of_robot(database, name), now),
        "budget": error_budget(now, active, _search_of(database, active, now)),
        "suspicious": [] if active is None else suspicious.of_campaigns(database, (one.id for one in active.campaigns)),
        "unseen": sum(one.identifiable is False or one.value is None for one in (active.parameters if active else ())),
        "chosen": bool(version or campaign or other),
        "controllers": WORDS,
    }


def _correction(database: Database, settings: Settings, robot: RobotReport) -> Correcting:
    """What is done for a robot now."""
    seen = corrector(database, settings)
    return seen.describe_correction(robot.name, robot.active_version, robot.controller_compensation)


def _version(database: Database, robot: str, newest: Sequence[VersionSummary], wanted: str) -> VersionSummary | None:
    """A version that the address names, of this robot, however many came after it; None: there is none such."""
    if not wanted:
        return None
    if found := next((one for one in newest if one.id == wanted), None):
        return found
    try:
        older = versions.get(database, wanted)
    except ServiceError:
        return None
    return older if older.robot == robot else None


def _search_of(database: Database, version: Version | None, now: Today) -> GapResult | None:
    """The gap search that made a version, if it is the newest; None: another job did."""
    if version is None or now.missing is None or now.missing.job_id != version.job_id:
        return None
    job = jobs.get(database, version.job_id)
    return job.result if GAP.is_kind_of(job) else None


def _campaign(
    database: Database, measured: Sequence[Campaign], version: VersionSummary | None, wanted: str, now: Today
) -> Campaign | None:
    """The campaign that was chosen, else that of today's errors, else one that no fit used, else the newest."""
    by_id = {one.id: one for one in measured}
    if wanted in by_id:
        return by_id[wanted]
    if version is not None and version.id == now.version_id and now.newest is not None:
        for seen in now.newest.campaigns:  # the picture beside today's number shows today's rows
            if seen.id in by_id:
                return by_id[seen.id]
    used = [] if version is None else versions.get(database, version.id).campaigns
    for use in ("validation", "confirmation", "train"):
        for one in used:
            if one.use == use and one.id in by_id:
                return by_id[one.id]
    return measured[-1] if measured else None


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
        raise ServiceError(f"This cannot be noted: {validation_words(error)}.", code="payload_invalid") from error


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
    shown = shown_robot(database, settings, robot, version, campaign, other)
    return render(request, "robot/overview.html", shown=shown)


@router.get("/robots/{robot}/state")
def state(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show how a robot stands, on each of its views: its state, and today's number with where it is from."""
    report, now = robots.get(database, robot), today.of_robot(database, robot)
    seen_on = ", ".join(f"{one.name}, {one.when}" for one in (now.newest.campaigns if now.newest else ()))
    said = assess_robot_state(now, _correction(database, settings, report))
    return render(request, "robot/state.html", robot=report, state=said, accuracy=accuracy_today(now), seen_on=seen_on)


@router.get("/robots/{robot}/settings")
def settings(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show what is rarely changed of a robot: what its controller does, remarks, description, and the shapes of its links."""
    report = robots.get(database, robot)
    shown = {
        "robot": report,
        "meshes": meshes.list_meshes(database, robot).meshes,
        "controllers": WORDS,
        "most_mb": MAX_MESH_MB,
        "most_triangles": MAX_TRIANGLES,
        "links": [meshes.BASE, *(joint.name for joint in report.joints)],
    }
    return render(request, "robot/settings.html", shown=shown)


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
    return redirect(request, f"/jobs/{job}")


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
    robots.add_repair(
        database, robot, parse_repair(what, at, kind=kind, campaign_id=campaign or None, rows=rows), actor
    )
    return Response(status_code=204, headers=ANEW)


@router.post("/robots/{robot}/repairs/{repair}/remove")
def remove_repair(robot: str, repair: str, database: DatabaseOfApp, _: Admin) -> Response:
    """Take back a repair that was recorded by mistake."""
    robots.remove_repair(database, robot, repair)
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
    found = scene.predict_by_versions(database, settings, robot, q, (version, other), campaign if row else "", row)
    return render(request, "robot/pose_part.html", pose=found)


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


@router.get("/robots/{robot}/correct")
def ask_for_path(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Ask for a path."""
    found = robots.get(database, robot)
    return render(
        request, "correct/path.html", robot=found, versions=versions.list_versions(database, robot, NEWEST).versions
    )
