"""What the views of jobs show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.jobs.check import JobCheck
from kilter_service.contract.jobs.job import Job, JobSummary, NewJob
from kilter_service.db import Database
from kilter_service.jobs import checking
from kilter_service.jobs import service as jobs
from kilter_service.jobs.registry import kind_of
from kilter_service.page.jobs import form, options, seal
from kilter_service.page.jobs.results import result_of
from kilter_service.paging import Page
from kilter_service.robots import service as robots

KINDS: Mapping[str, str] = {
    "identify": "Identify parameters",
    "gap": "Search for what is missing",
    "evaluate": "Evaluate a version",
    "plan": "Plan poses",
    "joint_parameters": "Measure joints",
}
MOST_JOBS = 50
CAMPAIGNS_USED = ("campaigns", "validation", "confirmation")


def listed(database: Database, robot: str | None) -> list[JobSummary]:
    """Return the newest jobs."""
    return jobs.listed(database, robot, Page(limit=MOST_JOBS)).jobs


def new(database: Database, robot: str, kind: str, chosen: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return what the form of a new job shows; ``chosen`` presets campaigns by use, and options by name.

    Raises:
        CoreError: no such kind of job.
        ServiceError: no such robot.

    """
    robots.get(database, robot)
    kind_of(kind)
    usual, others = options.fields(kind)
    return {
        "robot": robot,
        "kind": kind,
        "kinds": KINDS,
        "usual": usual,
        "others": others,
        "preset": {name: values[0] for name, values in chosen.items() if values and name not in CAMPAIGNS_USED},
        "campaigns": campaigns.listed(database, robot, Page()).campaigns,
        "uses": form.uses(chosen),
        "confirms": kind_of(kind).takes_confirmation,
        "jobs": listed(database, robot),
    }


def checked(database: Database, key: str, job: NewJob) -> tuple[JobCheck, str]:
    """Return the check of a job, and its seal if it would run, else an empty one."""
    given = seal.seal_of(database, key, job)  # of the campaigns as they were before the check read them
    found = checking.check(database, job)
    return found, given if found.would_run else ""


def run(database: Database, key: str, job: NewJob, given: str) -> Job:
    """Queue a job whose check has passed.

    Raises:
        ServiceError: it was not checked as it is.

    """
    seal.demand(database, key, job, given)
    return jobs.submit(database, job)


def shown(database: Database, job_id: str) -> tuple[Job, str, dict[str, Any]]:
    """Return a job, the template of its result (empty: there is none yet), and what fills it."""
    job = jobs.get(database, job_id)
    if job.state != "succeeded" or job.result is None:
        return job, "", {"ahead": ahead(database, job)}
    view = result_of(job.kind)
    return job, view.template, view.shown(database, job)


def ahead(database: Database, job: Job) -> int:
    """Return how many of the newest jobs wait that were asked for before this one."""
    if job.state != "queued":
        return 0
    return sum(other.state == "queued" and other.created_at < job.created_at for other in listed(database, None))
