"""Which part of a page shows the result of each kind of job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kilter_service.contract.jobs.registry import KINDS, Job
from kilter_service.ground.db import Database
from kilter_service.page.gap import service as story
from kilter_service.page.jobs import evaluation, identification, planned

Shown = Callable[[Database, Any], dict[str, Any]]


@dataclass(frozen=True)
class Result:
    """The template of a kind, and what fills it."""

    template: str
    shown: Shown


def default_context(database: Database, job: Job) -> dict[str, Any]:
    """Return what is shown of a job whose kind has no view of its own: what it says in words."""
    result = job.result
    return {
        "sentence": getattr(result, "sentence", None),
        "remedy": getattr(result, "remedy", None),
        "warnings": getattr(result, "warnings", None) or [],
        "version": getattr(result, "version_id", None),
        "robot": job.robot if KINDS[job.kind].watching else "",
    }


PLAIN = Result("jobs/plain.html", default_context)
RESULTS: dict[str, Result] = {
    "identify": Result("jobs/identify.html", identification.result_context),
    "gap": Result("gap/result.html", story.result_context),
    "evaluate": Result("jobs/evaluate.html", evaluation.result_context),
    "plan": Result("jobs/plan.html", planned.result_context),
}


def get_result_view(kind: str) -> Result:
    """Return how the result of a kind is shown."""
    return RESULTS.get(kind, PLAIN)
