"""What the views of jobs show."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping, Sequence
from typing import Any

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.jobs.registry import KINDS, Job, JobCheck, NewJob
from kilter_service.contract.jobs.shared import MadeVersion
from kilter_service.ground.core import core_effects
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.jobs import checking
from kilter_service.jobs import service as jobs
from kilter_service.jobs.registry import get_job_kind
from kilter_service.page.jobs import form, options
from kilter_service.page.jobs.results import get_result_view
from kilter_service.page.shared import lists
from kilter_service.page.shared.listed_jobs import KINDS as TITLES
from kilter_service.page.shared.listed_jobs import page_of_jobs
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions

# The seal of a passed check: Run is refused unless the check passed for exactly these inputs.
#
# The seal is a keyed hash of the job as it was checked and of its campaigns as they were then. Nothing is stored:
# Run computes it anew, so it fits no other input and no campaign that has changed since.


def compute_job_seal(database: Database, key: str, job: NewJob) -> str:
    """Return the seal of a job and its campaigns as they are now."""
    held = job.validation if isinstance(job.validation, list) else []
    used = [*job.campaigns, *held, *job.confirmation]
    state = [campaigns.get(database, campaign).model_dump(mode="json") for campaign in used]
    text = json.dumps([job.model_dump(mode="json"), state], sort_keys=True)
    return hmac.new(key.encode(), b"check of a job\n" + text.encode(), hashlib.sha256).hexdigest()


def demand(database: Database, key: str, job: NewJob, given: str) -> None:
    """Refuse a job that was not checked as it is.

    Raises:
        ServiceError: no check passed for these inputs, or a campaign has changed since.

    """
    if not hmac.compare_digest(compute_job_seal(database, key, job).encode(), given.encode()):
        raise ServiceError(
            "No check has passed for exactly these inputs, or a campaign has changed since: press Check, then Run.",
            code="option_invalid",
        )


MOST_JOBS = 50
MOST_OFFERED, MOST_SOUGHT = 8, 20  # campaigns beside those that are preset, and of a search
MOST_VERSIONS = 200  # that a field offers by name
CAMPAIGNS_USED = ("campaigns", "validation", "confirmation")


def new(database: Database, robot: str, kind: str, chosen: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return what the form of a new job shows; ``chosen`` presets campaigns by use, and options by name.

    Raises:
        CoreError: no such kind of job.
        ServiceError: no such robot.

    """
    robots.get(database, robot)
    get_job_kind(kind)
    usual, others = options.fields(kind)
    found = campaigns.list_campaigns(database, robot, Page()).campaigns[::-1]
    uses = form.uses(chosen) or form.by_role(kind, found)
    rest = [one for one in found if one.id not in uses]
    return {
        "robot": robot,
        "kind": kind,
        "kinds": TITLES,
        "usual": usual,
        "others": others,
        "preset": {name: values[0] for name, values in chosen.items() if values and name not in CAMPAIGNS_USED},
        "campaigns": [*(one for one in found if one.id in uses), *rest[:MOST_OFFERED]],
        "more": len(rest[MOST_OFFERED:]),
        "uses": uses,
        "versions": versions.list_versions(database, robot, Page(limit=MOST_VERSIONS)).versions,
        "effects": effects_in_words() if any(one.name == "effects" for one in (*usual, *others)) else {},
        "confirms": KINDS[kind].takes_confirmation,
        "found": page_of_jobs(database, robot, Page(limit=MOST_JOBS)),
    }


def sought(database: Database, robot: str, kind: str, text: str) -> dict[str, Any]:
    """Return the campaigns of a robot in whose name, device or notes all words of a text are, newest first."""
    get_job_kind(kind)
    found = campaigns.list_campaigns(database, robot, Page()).campaigns[::-1]
    part = lists.select_page(
        found, lists.Asked(search=text), lambda one: f"{one.name} {one.device} {one.notes} {one.id}", {}
    )
    shown = part.shown[:MOST_SOUGHT]
    return {"campaigns": shown, "found": part.found, "uses": {}, "confirms": KINDS[kind].takes_confirmation}


def effects_in_words() -> dict[str, str]:
    """Return the effects that a person may add to a model, by id, with what each is."""
    return {name: effect.summary for name, effect in sorted(core_effects.EFFECTS.items()) if not effect.nuisance}


def check_and_seal(database: Database, key: str, job: NewJob) -> tuple[JobCheck, str]:
    """Return the check of a job, and its seal if it would run, else an empty one."""
    given = compute_job_seal(database, key, job)  # of the campaigns as they were before the check read them
    found = checking.check(database, job)
    return found, given if found.would_run else ""


def run(database: Database, key: str, job: NewJob, given: str) -> Job:
    """Queue a job whose check has passed.

    Raises:
        ServiceError: it was not checked as it is.

    """
    demand(database, key, job, given)
    return jobs.submit(database, job)


def load_job_view(database: Database, job_id: str) -> tuple[Job, str, dict[str, Any]]:
    """Return a job, the template of its result (empty: there is none yet), and what fills it."""
    job = jobs.get(database, job_id)
    names = {
        one.id: one.name for one in campaigns.list_campaigns(database, job.robot, Page(), with_retired=True).campaigns
    }
    if job.state != "succeeded" or job.result is None:
        return job, "", {"names": names, "version": None, "place": jobs.places(database).get(job.id)}
    view = get_result_view(job.kind)
    makes_version = isinstance(job.result, MadeVersion)  # and has objections against it
    return job, view.template, {"names": names, "makes_version": makes_version, **view.shown(database, job)}
