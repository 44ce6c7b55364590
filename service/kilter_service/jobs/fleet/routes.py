"""Fleet jobs over HTTP."""

from __future__ import annotations

from fastapi import APIRouter, Response

from kilter_service.contract.jobs.fleet import FleetJob, FleetJobList, FleetJobSummary, NewFleetJob
from kilter_service.jobs.fleet import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.idempotency.key import OnceOnly
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp, PageOfJobs

router = APIRouter(prefix="/v1/fleet-jobs", tags=["jobs"], route_class=ConditionalRoute)


@router.post("", status_code=202)
def submit(
    fleet: NewFleetJob, response: Response, database: DatabaseOfApp, once: OnceOnly, _: Admin
) -> FleetJobSummary:
    """Queue a job for each of many robots, which identifies it anew."""
    queued = service.submit(database, fleet, once)
    response.headers["Location"] = f"/v1/fleet-jobs/{queued.id}"
    return queued


@router.get("")
def listed(database: DatabaseOfApp, page: PageOfJobs) -> FleetJobList:
    """List the newest fleet jobs."""
    return service.list_fleet_jobs(database, page)


@router.get("/{fleet_job}")
def get(fleet_job: str, database: DatabaseOfApp) -> FleetJob:
    """Show how far a fleet job is, and what became of each robot."""
    return service.get(database, fleet_job)


@router.post("/{fleet_job}/cancel")
def cancel(fleet_job: str, database: DatabaseOfApp, _: Admin) -> FleetJob:
    """Cancel the jobs of a fleet job that are not over."""
    return service.cancel(database, fleet_job)
