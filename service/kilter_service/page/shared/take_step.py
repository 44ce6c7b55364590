"""A button of a next step: it queues the job, with campaign and cause filled in."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs import checking
from kilter_service.jobs import service as jobs
from kilter_service.robots import service as robots
from kilter_service.versions.today import service as today

JOBS = {"rezero": "rezero", "evaluate": "evaluate", "plan": "plan", "plan_check": "plan", "search": "gap"}  # by step
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
    }
    options = presets.get(do, {})
    if do == "plan_check":
        options["version"] = robots.get(database, name).active_version
    asked = {"kind": JOBS[do], "robot": name, "campaigns": [campaign] if campaign else [], "options": options}
    job = NEW_JOB.validate_python(asked)
    if do == "search":
        _check_search(database, job)
    return jobs.submit(database, job).id


def _check_search(database: Database, job: NewJob) -> None:
    """Refuse a search that would fail.

    Raises:
        ServiceError: why it would.

    """
    found = checking.check(database, job)
    if not found.would_run:
        said = " ".join(one.message for one in found.problems)
        raise ServiceError(said, code="option_invalid", option="campaigns")
