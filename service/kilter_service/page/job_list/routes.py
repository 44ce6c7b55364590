"""The jobs of the whole server, newest first."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.route import PageRoute
from kilter_service.page.shared import listed_jobs
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import render
from kilter_service.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/jobs")
def listed(request: Request, database: DatabaseOfApp, robot: str = "") -> HTMLResponse:
    """List the jobs of every robot that may be seen, or of one, newest first."""
    found, part = listed_jobs.asked(database, robot or None, Asked.of(request, ("robot", "kind", "state")))
    return render(request, "job_list/list.html", found=found, part=part, robot=robot)
