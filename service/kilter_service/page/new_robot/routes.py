"""A robot added on the page."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.contract.units import ControllerCompensation
from kilter_service.page.new_robot import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.goals import parse_goals
from kilter_service.page.shell import get_root_path, redirect, render
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import WORDS
from kilter_service.web.auth.access import Admin
from kilter_service.web.concurrency import compute
from kilter_service.web.state import DatabaseOfApp, get_scratch

router = APIRouter(include_in_schema=False, route_class=PageRoute)
LONGEST = 900_000  # characters of a file
Short = Annotated[str, Form(max_length=200)]


@router.get("/new-robot")
def new(request: Request) -> HTMLResponse:
    """Ask what the robot is."""
    return render(request, "new_robot/new.html", presets=service.presets(), controllers=WORDS)


@router.post("/new-robot/check")
async def check(
    request: Request,
    name: Short,
    preset: Short = "",
    text: Annotated[str, Form(max_length=LONGEST)] = "",
    file: Short = "",
    table: Short = "",
    base_link: Short = "",
    tip_link: Short = "",
    compensation: Annotated[ControllerCompensation, Form()] = "unknown",
) -> HTMLResponse:
    """Show what a description comes to."""
    told = service.Told(name.strip(), preset, text, file, table, base_link.strip(), tip_link.strip(), compensation)
    with get_scratch(request).folder_for("new-robot") as folder:
        looked = await compute(request, service.preview_robot, told, folder)
    return render(request, "new_robot/looked.html", looked=looked)


@router.post("/new-robot")
def add(
    request: Request,
    database: DatabaseOfApp,
    _: Admin,
    document: Annotated[str, Form(max_length=2 * LONGEST)],
    tolerance_mm: Short = "",
    check_interval_days: Short = "",
) -> Response:
    """Add the robot that was shown, with how good it must be where that was said."""
    goals = parse_goals(tolerance_mm, check_interval_days)
    report, new = robots.add(database, service.parse_posted_document(document))
    if new:
        robots.change(database, report.name, goals)
    return redirect(request, f"{get_root_path(request)}/robots/{report.name}")
