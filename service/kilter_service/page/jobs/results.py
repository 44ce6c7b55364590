"""Which part of a page shows the result of each kind of job."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from kilter_service.contract.jobs.evaluate import EvaluateJob, EvaluateResult
from kilter_service.contract.jobs.registry import KINDS, Job
from kilter_service.contract.jobs.shared import MadeVersion
from kilter_service.ground.db import Database
from kilter_service.page.gap import service as story
from kilter_service.page.jobs import check_view, identification, planned, stages
from kilter_service.page.jobs.version_names import version_name
from kilter_service.page.shared.in_names import in_names

EVALUATED = {"After": "Evaluated"}  # it may be older than the rows, or the nominal robot itself


def result_context(database: Database, job: EvaluateJob) -> dict[str, Any]:
    """Return what ``jobs/evaluate.html`` shows."""
    result = job.result or EvaluateResult()
    return {
        "result": result,
        "version": result.version_id,
        "called": version_name(database, result.version_id),
        "campaigns": [
            (name, errors, stages.bars(errors, f"campaign {name}", EVALUATED))
            for name, errors in (result.metrics or {}).items()
        ],
    }


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
        "facts": _plain_facts(result) if result is not None else {},
        "robot": job.robot if KINDS[job.kind].watching else "",
    }


def _plain_facts(result: BaseModel) -> dict[str, str]:
    """Return what a result without a sentence says in numbers and words, by name."""
    given = result.model_dump(mode="json", exclude_unset=True)
    if "sentence" in given or isinstance(result, MadeVersion):
        return {}
    parts = {name: value if isinstance(value, dict) else {"": value} for name, value in given.items()}
    return {
        f"{name.replace('_', ' ').capitalize()} {key}".rstrip(): str(value)
        for name, part in parts.items()
        for key, value in part.items()
        if isinstance(value, int | float | str)
    }


def rezero_context(database: Database, job: Job) -> dict[str, Any]:
    """Return what is shown of a re-zeroing: what it changed; activating it is the next step on the same page."""
    shown = default_context(database, job)
    return {**shown, "sentence": in_names(database, shown["sentence"] or "")}


PLAIN = Result("jobs/plain.html", default_context)
RESULTS: dict[str, Result] = {
    "identify": Result("jobs/identify.html", identification.result_context),
    "gap": Result("gap/result.html", story.result_context),
    "evaluate": Result("jobs/evaluate.html", result_context),
    "drift": Result("jobs/drift.html", check_view.result_context),
    "rezero": Result("jobs/rezero.html", rezero_context),
    "plan": Result("jobs/plan.html", planned.result_context),
}


def get_result_view(kind: str) -> Result:
    """Return how the result of a kind is shown."""
    return RESULTS.get(kind, PLAIN)
