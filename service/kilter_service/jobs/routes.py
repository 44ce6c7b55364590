"""Jobs over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from kilter_service.contract.jobs.job import FINAL, JobList
from kilter_service.contract.jobs.registry import Job, JobCheck, NewJob
from kilter_service.jobs import checking, service
from kilter_service.jobs.events import get_job_followers, has_received_end
from kilter_service.jobs.request import JobRoute
from kilter_service.web.auth.access import Admin
from kilter_service.web.auth.following import limit_event_stream
from kilter_service.web.conditional import FOR_GOOD
from kilter_service.web.idempotency.key import OnceOnly
from kilter_service.web.page_query import PageOfJobs
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=JobRoute)


@router.post("", status_code=202)
def submit(job: NewJob, response: Response, database: DatabaseOfApp, once: OnceOnly, _: Admin) -> Job:
    """Queue a job."""
    queued = service.submit(database, job, once)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


@router.post("/check")
def check(job: NewJob, database: DatabaseOfApp) -> JobCheck:
    """Say what a job would do, at once: what it uses, what its data can tell, what is missing, how long it takes."""
    return checking.check(database, job)


@router.get("")
def listed(database: DatabaseOfApp, page: PageOfJobs, robot: str | None = None) -> JobList:
    """List the newest jobs."""
    return service.list_jobs(database, robot, page)


@router.get("/{job}")
def get(job: str, response: Response, database: DatabaseOfApp) -> Job:
    """Show a job and, when it is over, its result."""
    found = service.get(database, job)
    if found.state in FINAL:
        response.headers["Cache-Control"] = FOR_GOOD
    return found


@router.get(
    "/{job}/events",
    response_class=StreamingResponse,
    responses={
        200: {"content": {"text/event-stream": {}}, "description": "Events `progress`, then one `end`"},
        204: {"description": "`Last-Event-ID` is that of the end: there is no more to come"},
    },
)
async def follow(
    job: str,
    request: Request,
    database: DatabaseOfApp,
    last_event_id: Annotated[
        str | None, Header(max_length=64, description="Id of the last event received: what it said is not told again.")
    ] = None,
) -> Response:
    """Follow a job as server-sent events."""
    found = await run_in_threadpool(service.get, database, job)
    if has_received_end(found, last_event_id):
        return Response(status_code=204)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    news = limit_event_stream(request, get_job_followers(request.app).events(job, last_event_id))
    return StreamingResponse(news, media_type="text/event-stream", headers=headers)


@router.post("/{job}/cancel")
def cancel(job: str, database: DatabaseOfApp, _: Admin) -> Job:
    """Stop a job."""
    return service.cancel(database, job)
