"""What a form or a button asks for: goals, the next step, and the job whose poses were measured."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter, ValidationError

from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.gap import GAP, GapJob
from kilter_service.contract.jobs.plan import PLAN
from kilter_service.contract.jobs.registry import Job, NewJob
from kilter_service.contract.wording import RobotChange
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs import checking
from kilter_service.jobs import service as jobs
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.today import service as today

WORDS = {
    "tolerance_mm": "a tolerance in mm, above 0 and at most 1000",
    "check_interval_days": "whole days between checks, from 1 to 3650",
}


def parse_goals(tolerance_mm: str, check_interval_days: str) -> RobotChange:
    """Read both; empty: not stated.

    Raises:
        ServiceError: one is not a number that makes sense.

    """
    typed = {"tolerance_mm": tolerance_mm.strip() or None, "check_interval_days": check_interval_days.strip() or None}
    try:
        return RobotChange.model_validate(typed, strict=False)
    except ValidationError as error:
        place = str(error.errors()[0]["loc"][0])
        raise ServiceError(
            f"{typed.get(place)!r} is not {WORDS[place]}: leave it empty where none is stated.",
            code="payload_invalid",
            field=place,
        ) from None


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


def proposal(database: Database, campaign: Campaign, job: str) -> dict[str, Any] | None:
    """Return what a campaign leads back to: the job, the search that is made again with it, and whether it uses it already."""
    found = get_proposing_job(database, campaign.robot, job)
    if found is None:
        return None
    search = _search(database, found)
    held = search.validation if search is not None and isinstance(search.validation, list) else []
    used = [] if search is None else [*search.campaigns, *held, *search.confirmation]
    return {"job": found, "search": search, "taken": campaign.id in used}


def _search(database: Database, job: Job) -> GapJob | None:
    """Return the job itself, or the search whose version a plan was made for."""
    if PLAN.is_kind_of(job) and job.options.version is not None:
        job = jobs.get(database, versions.get(database, job.options.version).job_id)
    return job if GAP.is_kind_of(job) and job.state == "succeeded" else None


# by step
JOBS = {
    "rezero": "rezero",
    "evaluate": "evaluate",
    "plan": "plan",
    "plan_check": "plan",
    "search": "gap",
    "identify": "identify",
}
HELD_OUT = 0.25  # of pictures
NEW_JOB: TypeAdapter[NewJob] = TypeAdapter(NewJob)


def take_step(database: Database, name: str, do: str, campaign: str) -> str:
    """Queue the job of a next step, and return its id.

    Raises:
        ServiceError: this does not come next any more.

    """
    standing = today.of_robot(database, name).standing
    steps = [] if standing is None else [*standing.steps, *(step for one in standing.first for step in one.steps)]
    step = next((one for one in steps if one.do == do and (one.campaign_id or "") == campaign), None)
    if step is None or do not in JOBS:
        raise ServiceError(
            f"This is not what comes next for {name} any more: load the page anew.", code="option_invalid", option="do"
        )
    presets: dict[str, dict[str, Any]] = {
        "rezero": {"causes": step.causes},
        "plan": {"purpose": "identify", "within": "limits"},
        "plan_check": {"purpose": "check"},
        "identify": {"effects": [{"id": "axial_compliance"}]},
    }
    options = presets.get(do, {})
    if do == "plan_check":
        options["version"] = robots.get(database, name).active_version
    asked: dict[str, Any] = {
        "kind": JOBS[do],
        "robot": name,
        "campaigns": [campaign] if campaign else [],
        "options": options,
    }
    if do == "identify":
        asked["validation"] = HELD_OUT
    job = NEW_JOB.validate_python(asked)
    if do == "search":
        _check_search(database, job)
    return jobs.submit(database, job).id


def _check_search(database: Database, job: NewJob) -> None:
    """Refuse a search that would fail."""
    found = checking.check(database, job)
    if not found.would_run:
        said = " ".join(one.message for one in found.problems)
        raise ServiceError(said, code="option_invalid", option="campaigns")
