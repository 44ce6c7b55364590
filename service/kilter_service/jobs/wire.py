"""Jobs as they go over the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from kilter_core.parameters import display_unit_and_scale
from kilter_service.contract.fits import NullDirection
from kilter_service.contract.gap_details import Detectable, Untestable
from kilter_service.contract.jobs.check import (
    CheckedCampaign,
    DriftCheck,
    Duration,
    EvaluateCheck,
    GapCheck,
    HeldOut,
    Identifiability,
    IdentifyCheck,
    JobCheck,
    JobProblem,
    JointParametersCheck,
    Missing,
    PlanCheck,
    RezeroCheck,
    Testability,
    UnknownParameter,
)
from kilter_service.contract.jobs.drift import DriftResult
from kilter_service.contract.jobs.evaluate import EvaluateResult
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.jobs.identify import IdentifyResult
from kilter_service.contract.jobs.job import (
    DriftJob,
    EvaluateJob,
    GapJob,
    IdentifyJob,
    Job,
    JobError,
    JobSummary,
    JointParametersJob,
    PlanJob,
    Progress,
    RezeroJob,
)
from kilter_service.contract.jobs.joint_parameters import JointParametersResult
from kilter_service.contract.jobs.plan import PlanResult
from kilter_service.contract.jobs.rezero import RezeroResult
from kilter_service.contract.units import Asked
from kilter_service.contract.written import as_written
from kilter_service.ground.wire import to_mm
from kilter_service.jobs.job_preview import JobPreview
from kilter_service.jobs.records import JobRecord, ListedJob, ProgressRecord
from kilter_service.jobs.registry import get_job_kind

if TYPE_CHECKING:
    from kilter_core.gap.check import GapCheck as FoundByCheck
    from kilter_core.identify.check import IdentificationCheck

ANSWERS: dict[str, tuple[type[Job], type[BaseModel]]] = {
    "identify": (IdentifyJob, IdentifyResult),
    "gap": (GapJob, GapResult),
    "evaluate": (EvaluateJob, EvaluateResult),
    "plan": (PlanJob, PlanResult),
    "joint_parameters": (JointParametersJob, JointParametersResult),
    "drift": (DriftJob, DriftResult),
    "rezero": (RezeroJob, RezeroResult),
}


CHECKS: dict[str, type[JobCheck]] = {
    "identify": IdentifyCheck,
    "gap": GapCheck,
    "evaluate": EvaluateCheck,
    "plan": PlanCheck,
    "joint_parameters": JointParametersCheck,
    "drift": DriftCheck,
    "rezero": RezeroCheck,
}


def progress_json(record: ProgressRecord) -> str:
    """Write how far a job is, as its events say it."""
    told = Progress(fraction=record.fraction, stage=record.stage)
    return f'{{"id":"{record.id}","state":"{record.state}","progress":{told.model_dump_json()}}}'


def job(record: JobRecord) -> Job:
    """Say all of a job; what an earlier release wrote in another form is left out."""
    answer, result = ANSWERS[record.kind]
    options: Asked = as_written(get_job_kind(record.kind).options, record.request.options)
    return answer(
        **_summary_fields(record),
        campaigns=record.request.campaigns,
        validation=record.request.validation,
        confirmation=record.request.confirmation,
        options=options,
        attempts=record.attempts,
        result=None if record.result is None else as_written(result, record.result),
    )


def summary(record: ListedJob) -> JobSummary:
    """Say what lists tell of a job."""
    return JobSummary(**_summary_fields(record))


def _summary_fields(record: ListedJob) -> dict[str, Any]:
    return {
        "id": record.id,
        "kind": record.kind,
        "robot": record.robot,
        "name": record.name,
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
    own: dict[str, Any] = {}
    if kind == "identify":
        own = {"identifiability": None if found.identification is None else _identifiability(found.identification)}
    elif kind == "gap":
        own = {"testability": None if found.search is None else _testability(found.search)}
    return CHECKS[kind](
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
        **own,
    )


def _identifiability(found: IdentificationCheck) -> Identifiability:
    return Identifiability(
        parameters=len(found.names),
        rank=found.rank,
        identifiable=list(found.known),
        not_identifiable=[UnknownParameter(name=u.name, reason=u.reason, remedy=u.remedy) for u in found.unknown],
        null_directions=[NullDirection(**direction) for direction in found.directions],
        noise_mm=to_mm(found.noise),
        noise_from=found.noise_source,
    )


def _testability(found: FoundByCheck) -> Testability:
    testable = []
    for one in found.testable:
        unit, scale = display_unit_and_scale(one.unit)
        testable.append(
            Detectable(
                id=one.id,
                parameter=one.parameter,
                unit=unit,
                smallest_detectable=one.smallest * scale,
                visibility=one.visibility,
            )
        )
    untestable = [
        Untestable(
            id=u.id,
            joints=None if u.joints is None else [j + 1 for j in u.joints],
            reason=u.reason,
            remedy=u.remedy,
            missing=u.missing or None,
        )
        for u in found.not_testable
    ]
    return Testability(testable=testable, not_testable=untestable)
