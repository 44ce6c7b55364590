"""The job whose poses a campaign was measured at, and what follows from that."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.gap import GAP, GapJob
from kilter_service.contract.jobs.plan import PLAN
from kilter_service.contract.jobs.registry import Job
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs import service as jobs
from kilter_service.versions import service as versions


@dataclass(frozen=True)
class Proposing:
    """The job, and the search that is made again with the campaign (None: none asked for its poses)."""

    job: Job
    search: GapJob | None
    taken: bool  # the search uses the campaign already


def get_proposing_job(database: Database, robot: str, job: str) -> Job | None:
    """Return the job that an address names; None: it names none.

    Raises:
        ServiceError: there is none, or it is of another robot.

    """
    if not job:
        return None
    found = jobs.get(database, job)
    if found.robot != robot:
        raise ServiceError(
            f"Job {job} is of robot {found.robot!r}, not of {robot!r}: leave it out of the address, or drop the file there.",
            code="option_invalid",
            job=job,
        )
    return found


def proposal(database: Database, campaign: Campaign, job: str) -> Proposing | None:
    """Return what a campaign leads back to."""
    found = get_proposing_job(database, campaign.robot, job)
    if found is None:
        return None
    search = _search(database, found)
    taken = search is not None and campaign.id in {
        *search.campaigns,
        *_held_out_campaigns(search),
        *search.confirmation,
    }
    return Proposing(found, search, taken)


def _search(database: Database, job: Job) -> GapJob | None:
    """Return the job itself, or the search whose version a plan was made for."""
    if PLAN.is_kind_of(job) and job.options.version is not None:
        job = jobs.get(database, versions.get(database, job.options.version).job_id)
    return job if GAP.is_kind_of(job) and job.state == "succeeded" else None


def _held_out_campaigns(job: GapJob) -> list[str]:
    return job.validation if isinstance(job.validation, list) else []
