"""The jobs of the whole server, newest first."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.ground.errors import ServiceError
from kilter_service.jobs import service as jobs
from kilter_service.page.route import PageRoute
from kilter_service.page.shared import listed_jobs
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import get_root_path, redirect, render
from kilter_service.versions.predictions.differences import resolve_version_id
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)
MOST_SEARCHES = 12


@router.get("/jobs")
def list_jobs(request: Request, database: DatabaseOfApp, robot: str = "") -> HTMLResponse:
    """List the jobs of every robot that may be seen, or of one, newest first."""
    found, part = listed_jobs.select_jobs(
        database, robot or None, Asked.from_request(request, ("robot", "kind", "state"))
    )
    return render(request, "job_list/list.html", found=found, part=part, robot=robot)


@router.get("/jobs/compare")
def compare(
    request: Request,
    database: DatabaseOfApp,
    job: Annotated[list[str] | None, Query(max_length=MOST_SEARCHES)] = None,
) -> Response:
    """Compare searches that were ticked in the list, by the versions that they made."""
    wanted = list(dict.fromkeys(job or []))
    if len(wanted) < 2:
        raise ServiceError("Tick at least two searches to compare them.", code="option_invalid", option="job")
    robot = jobs.get(database, wanted[0]).robot
    asked = urlencode([("version", resolve_version_id(one)) for one in wanted])
    return redirect(request, f"{get_root_path(request)}/robots/{robot}/versions/compare?{asked}")
