"""Jobs as they go over the wire."""

from __future__ import annotations

from typing import Any

from kilter_service.contract.jobs.check import CheckedCampaign, Duration, HeldOut, JobProblem, Missing
from kilter_service.contract.jobs.job import JobError, JobSummary, Progress
from kilter_service.contract.jobs.registry import Job, JobCheck
from kilter_service.contract.written import as_written
from kilter_service.ground.called import display_name
from kilter_service.jobs.job_preview import JobPreview
from kilter_service.jobs.records import JobRecord, ListedJob, ProgressRecord
from kilter_service.jobs.registry import get_job_kind


def progress_json(record: ProgressRecord) -> str:
    """Write how far a job is, as its events say it."""
    told = Progress(fraction=record.fraction, stage=record.stage)
    return f'{{"id":"{record.id}","state":"{record.state}","progress":{told.model_dump_json()}}}'


def job(record: JobRecord) -> Job:
    """Say all of a job; what an earlier release wrote in another form is left out."""
    kind = get_job_kind(record.kind).contract
    return kind.job(
        **_summary_fields(record),
        campaigns=record.request.campaigns,
        validation=record.request.validation,
        confirmation=record.request.confirmation,
        options=as_written(kind.options, record.request.options),
        attempts=record.attempts,
        result=None if record.result is None else as_written(kind.result, record.result),
    )


def summary(record: ListedJob) -> JobSummary:
    """Say what lists tell of a job."""
    return JobSummary(**_summary_fields(record))


def _summary_fields(record: ListedJob) -> dict[str, Any]:
    return {
        "id": record.id,
        "kind": record.kind,
        "robot": record.robot,
        "name": display_name(record),
        "state": record.state,
        "progress": Progress(fraction=record.fraction, stage=record.stage),
        "error": None if record.error is None else JobError(**record.error),
        "asked_by": record.asked_by,
        "created_at": record.created_at,
        "started_at": record.started_at,
        "finished_at": record.finished_at,
    }


def check(
    kind: str, robot: str, version: str | None, found: JobPreview, campaigns: list[CheckedCampaign], duration: Duration
) -> JobCheck:
    """Say what a job would do."""
    job_kind = get_job_kind(kind)
    return job_kind.contract.preview(
        kind=kind,
        robot=robot,
        version=version,
        would_run=not found.problems,
        problems=[JobProblem(code=error.code, message=error.message) for error in found.problems],
        campaigns=campaigns,
        rows=found.rows,
        poses=found.poses,
        held_out=HeldOut(how=found.how, rows=found.held_rows, poses=found.held_poses),
        missing=[Missing(what=one.what, reason=one.reason, remedy=one.remedy) for one in found.missing],
        limited=found.limited,
        duration_s=duration,
        **job_kind.describe_preview(found),
    )
