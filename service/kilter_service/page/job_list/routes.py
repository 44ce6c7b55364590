"""The jobs of the whole server, newest first."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.route import PageRoute
from kilter_service.page.shared import listed_jobs
from kilter_service.page.shell import render
from kilter_service.page_query import PageOfJobs
from kilter_service.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/jobs")
def listed(request: Request, database: DatabaseOfApp, page: PageOfJobs, robot: str | None = None) -> HTMLResponse:
    """List the newest jobs of every robot that may be seen, or of one."""
    return render(request, "job_list/list.html", found=listed_jobs.listed(database, robot, page), robot=robot)
