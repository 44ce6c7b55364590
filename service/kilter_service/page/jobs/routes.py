"""Jobs in the browser."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import HTMLResponse, PlainTextResponse

from kilter_service.jobs import service as jobs
from kilter_service.page.jobs import form, planned, service
from kilter_service.page.jobs.version_names import version_name
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.listed_jobs import KINDS
from kilter_service.page.shell import get_root_path, is_part, redirect, render
from kilter_service.web.auth.access import Admin
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)
SEAL = "seal"


async def form_texts(request: Request) -> dict[str, str]:
    """Return the texts of a form."""
    return {name: value for name, value in (await request.form()).items() if isinstance(value, str)}


Typed = Annotated[dict[str, str], Depends(form_texts)]


@router.get("/robots/{robot}/jobs")
def new(robot: str, request: Request, database: DatabaseOfApp, kind: str = "identify") -> HTMLResponse:
    """Show the form of a new job, and the robot's jobs."""
    chosen = {name: request.query_params.getlist(name) for name in request.query_params}
    return render(request, "jobs/new.html", **service.new(database, robot, kind, chosen))


@router.get("/robots/{robot}/jobs/campaigns")
def campaigns(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    kind: Annotated[str, Query(max_length=40)] = "identify",
    sought: Annotated[str, Query(max_length=200)] = "",
) -> HTMLResponse:
    """Find campaigns for the form of a new job."""
    found = service.sought(database, robot, kind, sought)
    template = "jobs/campaigns_part.html" if is_part(request) else "jobs/campaigns.html"
    return render(request, template, robot=robot, kind=kind, **found)


@router.post("/robots/{robot}/jobs/check")
def check(robot: str, request: Request, database: DatabaseOfApp, texts: Typed) -> HTMLResponse:
    """Say what the job would do; if it would run, hand out the seal that Run asks for."""
    found, seal = service.check_and_seal(database, request.app.state.token, form.parse_new_job(robot, texts))
    called = version_name(database, found.version)
    return render(request, "jobs/check.html", check=found, seal=seal, robot=robot, called=called)


@router.post("/robots/{robot}/jobs")
def run(robot: str, request: Request, database: DatabaseOfApp, texts: Typed, _: Admin) -> Response:
    """Queue a job whose check has passed."""
    asked = form.parse_new_job(robot, texts)
    queued = service.run(database, request.app.state.token, asked, texts.get(SEAL, ""))
    return redirect(request, f"{get_root_path(request)}/jobs/{queued.id}")


@router.get("/jobs/{job}")
def show_job(job: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show a job: how far it is, why it failed, or what came out."""
    found, template, filled = service.load_job_view(database, job)
    return render(
        request, "jobs/job.html", job=found, part=template, kinds=KINDS, again=form.query_from_job(found), **filled
    )


@router.get("/jobs/{job}/poses.csv")
def poses(job: str, database: DatabaseOfApp) -> Response:
    """Download the poses that a plan or a search proposes."""
    found = jobs.get(database, job)
    named = {"Content-Disposition": f'attachment; filename="poses-{found.id}.csv"'}
    return PlainTextResponse(planned.proposed_poses_csv(found), media_type="text/csv", headers=named)


@router.post("/jobs/{job}/cancel")
def cancel(job: str, request: Request, database: DatabaseOfApp, _: Admin) -> Response:
    """Stop a job."""
    jobs.cancel(database, job)
    return redirect(request, f"{get_root_path(request)}/jobs/{job}")
