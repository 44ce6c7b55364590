"""Jobs as they go over the wire."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from kilter_service.contract.jobs.evaluate import EvaluateResult
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.jobs.identify import IdentifyResult
from kilter_service.contract.jobs.job import (
    EvaluateJob,
    GapJob,
    IdentifyJob,
    Job,
    JobError,
    JobSummary,
    JointParametersJob,
    PlanJob,
    Progress,
)
from kilter_service.contract.jobs.joint_parameters import JointParametersResult
from kilter_service.contract.jobs.plan import PlanResult
from kilter_service.contract.units import Asked
from kilter_service.contract.written import as_written
from kilter_service.jobs.records import JobRecord
from kilter_service.jobs.registry import kind_of

ANSWERS: dict[str, tuple[type[Job], type[BaseModel]]] = {
    "identify": (IdentifyJob, IdentifyResult),
    "gap": (GapJob, GapResult),
    "evaluate": (EvaluateJob, EvaluateResult),
    "plan": (PlanJob, PlanResult),
    "joint_parameters": (JointParametersJob, JointParametersResult),
}


def job(record: JobRecord) -> Job:
    """Say all of a job; what an earlier release wrote otherwise is left out."""
    answer, result = ANSWERS[record.kind]
    options: Asked = as_written(kind_of(record.kind).options, record.request.options)
    return answer(
        **_told(record),
        campaigns=record.request.campaigns,
        validation=record.request.validation,
        confirmation=record.request.confirmation,
        options=options,
        attempts=record.attempts,
        result=None if record.result is None else as_written(result, record.result),
    )


def summary(record: JobRecord) -> JobSummary:
    """Say what lists tell of a job."""
    return JobSummary(**_told(record))


def _told(record: JobRecord) -> dict[str, Any]:
    return {
        "id": record.id,
        "kind": record.kind,
        "robot": record.robot,
        "name": record.name,
        "state": record.state,
        "progress": Progress(fraction=record.fraction, stage=record.stage),
        "error": None if record.error is None else JobError(**record.error),
        "created_at": record.created_at,
        "started_at": record.started_at,
        "finished_at": record.finished_at,
    }
