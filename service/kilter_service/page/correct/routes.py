"""The view in which a path is corrected."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from kilter_service.ground.paging import Page
from kilter_service.page.route import PageRoute
from kilter_service.page.shell import render
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)
NEWEST = Page(limit=50)


@router.get("/robots/{robot}/correct")
def view(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Ask for a path."""
    found = robots.get(database, robot)
    return render(
        request, "correct/path.html", robot=found, versions=versions.list_versions(database, robot, NEWEST).versions
    )
