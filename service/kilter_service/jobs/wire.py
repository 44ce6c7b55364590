"""Jobs as they go over the wire."""

from __future__ import annotations

from typing import Any

from kilter_service.contract.jobs.check import CheckedCampaign, Duration, HeldOut, JobProblem, Missing
from kilter_service.contract.jobs.job import JobError, JobSummary, Progress
from kilter_service.contract.jobs.registry import Job, JobCheck
from kilter_service.contract.written import as_written
from kilter_service.ground.by_name import copy_fields
from kilter_service.ground.called import display_name
from kilter_service.jobs.job_preview import JobPreview
from kilter_service.jobs.records import JobRecord, ListedJob, ProgressRecord
from kilter_service.jobs.registry import get_job_kind


def progress_json(record: ProgressRecord) -> str:
    """Write how far a job is, as its events say it."""
    told = copy_fields(Progress, record)
    return f'{{"id":"{record.id}","state":"{record.state}","progress":{told.model_dump_json()}}}'


def job(record: JobRecord) -> Job:
    """Say all of a job; what an earlier release wrote in another form is left out."""
    kind = get_job_kind(record.kind).contract
    return copy_fields(
        kind.job,
        record,
        **_read_out(record),
        campaigns=record.request.campaigns,
        validation=record.request.validation,
        confirmation=record.request.confirmation,
        options=as_written(kind.options, record.request.options),
        result=None if record.result is None else as_written(kind.result, record.result),
    )


def summary(record: ListedJob) -> JobSummary:
    """Say what lists tell of a job."""
    return copy_fields(JobSummary, record, **_read_out(record))


def _read_out(record: ListedJob) -> dict[str, Any]:
    """What a list tells that no field of the record holds."""
    return {
        "name": display_name(record),
        "progress": copy_fields(Progress, record),
        "error": None if record.error is None else JobError(**record.error),
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
        problems=[copy_fields(JobProblem, error) for error in found.problems],
        campaigns=campaigns,
        rows=found.rows,
        poses=found.poses,
        held_out=HeldOut(how=found.how, rows=found.held_rows, poses=found.held_poses),
        missing=[copy_fields(Missing, one) for one in found.missing],
        limited=found.limited,
        duration_s=duration,
        **job_kind.describe_preview(found),
    )
