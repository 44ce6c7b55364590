"""The story of a gap search in the browser."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Request, Response

from kilter_service.page.gap import next_steps, service
from kilter_service.page.route import PageRoute
from kilter_service.page.shell import get_root_path, redirect
from kilter_service.web.auth.access import Admin
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.post("/jobs/{job}/gap/plan")
def plan(job: str, request: Request, database: DatabaseOfApp, _: Admin) -> Response:
    """Queue a plan of poses that make the claims surer."""
    queued = next_steps.plan(database, service.get_gap_job(database, job))
    return redirect(request, f"{get_root_path(request)}/jobs/{queued.id}")


@router.post("/jobs/{job}/gap/again")
def repeat_search(
    job: str,
    request: Request,
    database: DatabaseOfApp,
    _: Admin,
    campaign: Annotated[str, Form(max_length=100)],
    use: Annotated[next_steps.Use, Form()],
) -> Response:
    """Queue the search again with a further campaign."""
    queued = next_steps.search_again(database, service.get_gap_job(database, job), campaign, use)
    return redirect(request, f"{get_root_path(request)}/jobs/{queued.id}")
