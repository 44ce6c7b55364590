"""The result of an evaluation: errors of each campaign, or the criteria of ISO 9283."""

from __future__ import annotations

from typing import Any

from kilter_service.contract.jobs.evaluate import EvaluateJob, EvaluateResult
from kilter_service.ground.db import Database
from kilter_service.page.jobs import stages
from kilter_service.page.jobs.version_names import version_name

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
