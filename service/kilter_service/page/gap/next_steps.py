"""What follows a search: poses that make its claims surer, and the search again with their campaign."""

from __future__ import annotations

from typing import Literal

from kilter_service.contract.jobs.gap import GAP, GapJob
from kilter_service.contract.jobs.plan import PLAN, PlanOptions
from kilter_service.contract.jobs.registry import Job
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs import service as jobs

Use = Literal["rows", "confirmation"]


def plan(database: Database, job: GapJob) -> Job:
    """Queue a plan of poses: those that tell apart what is undecided, else those that show what was named best."""
    result = job.result
    if result is None or result.version_id is None:
        raise ServiceError(f"Job {job.id} made no version to plan with.", code="option_invalid", job=job.id)
    if any(pose.information_factor is not None for pose in result.next_poses or []):
        options = PlanOptions(purpose="separate", version=result.version_id)
    else:
        asked = {"purpose": "identify", "version": result.version_id, "effects": _effects(job)}
        options = PlanOptions.model_validate(asked)
    return jobs.submit(database, PLAN.request(kind="plan", robot=job.robot, campaigns=job.campaigns, options=options))


def _effects(job: GapJob) -> list[str]:
    effects = (job.result.effects if job.result is not None else None) or []
    return list(dict.fromkeys(effect.id for effect in effects if not effect.empirical))


def search_again(database: Database, job: GapJob, campaign: str, use: Use) -> Job:
    """Queue the same search with a further campaign: as rows to search, or as a confirmation."""
    more = (
        {"campaigns": [*job.campaigns, campaign]} if use == "rows" else {"confirmation": [*job.confirmation, campaign]}
    )
    asked = {
        "kind": "gap",
        "robot": job.robot,
        "campaigns": job.campaigns,
        "validation": job.validation,
        "confirmation": job.confirmation,
        "options": job.options.model_dump(mode="json", exclude_unset=True),
        **more,
    }
    return jobs.submit(database, GAP.request.model_validate(asked))
