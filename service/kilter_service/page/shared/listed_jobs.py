"""Jobs in lists: of the whole server, or of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kilter_service.contract.jobs.job import JobSummary
from kilter_service.db import Database
from kilter_service.jobs import service as jobs
from kilter_service.jobs.records import Place
from kilter_service.page.shared.lists import Asked, Part, part
from kilter_service.paging import Page

KINDS: Mapping[str, str] = {
    "identify": "Identify parameters",
    "gap": "Search for what is missing",
    "evaluate": "Evaluate a version",
    "plan": "Plan poses",
    "joint_parameters": "Measure joints",
    "drift": "Check for drift",
    "rezero": "Re-zero what moved",
}


@dataclass(frozen=True)
class Listed:
    """Jobs, newest first; where those stand that are not over; and the cursor of older ones."""

    jobs: Sequence[JobSummary]
    places: Mapping[str, Place]
    more: str | None

    @property
    def kinds(self) -> Mapping[str, str]:
        """What the kinds of jobs are called."""
        return KINDS

    @property
    def searches(self) -> int:
        """How many of these jobs are searches that can be compared."""
        return sum(job.kind == "gap" and job.state == "succeeded" for job in self.jobs)


STATES = ("queued", "running", "succeeded", "failed", "cancelled")


def asked(database: Database, robot: str | None, wanted: Asked) -> tuple[Listed, Part[JobSummary]]:
    """Return the jobs that the address asks for, of one robot or of all that may be seen."""
    found = part(
        jobs.list_jobs(database, robot, Page()).jobs,
        wanted,
        lambda job: f"{job.name} {job.robot} {KINDS.get(job.kind, job.kind)} {job.asked_by} {job.id}",
        {
            "name": lambda job: job.name or job.id,
            "robot": lambda job: job.robot,
            "kind": lambda job: KINDS.get(job.kind, job.kind),
            "state": lambda job: STATES.index(job.state),
            "asked": lambda job: job.created_at,
        },
        {"kind": lambda job: job.kind, "state": lambda job: job.state},
        "-asked",
    )
    return Listed(found.shown, jobs.places(database), None), found


def page_of_jobs(database: Database, robot: str | None, page: Page) -> Listed:
    """Return a page of jobs, of one robot or of all that may be seen."""
    found = jobs.list_jobs(database, robot, page)
    return Listed(found.jobs, jobs.places(database), found.next)
