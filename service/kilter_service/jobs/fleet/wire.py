"""Fleet jobs as they go over the wire."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from kilter_service.contract.jobs.fleet import FleetCounts, FleetJob, FleetJobSummary, FleetRobot
from kilter_service.contract.jobs.job import FINAL, JobError, Progress, State
from kilter_service.contract.remarks import Remark
from kilter_service.contract.versions import Comparison, Objection
from kilter_service.contract.written import as_written
from kilter_service.jobs.fleet.records import FleetRecord, FleetRobotRecord


def fleet_job(record: FleetRecord, robots: Sequence[FleetRobotRecord]) -> FleetJob:
    """Say all of a fleet job."""
    return FleetJob(**_summary_fields(record), report=[_robot(one) for one in robots])


def summary(record: FleetRecord) -> FleetJobSummary:
    """Say what lists tell of a fleet job."""
    return FleetJobSummary(**_summary_fields(record))


def _summary_fields(record: FleetRecord) -> dict[str, Any]:
    counts = FleetCounts(**{one.state or "refused": one.number for one in record.counts})
    robots = sum(one.number for one in record.counts)
    over = robots - counts.queued - counts.running
    ended = sum(one.number if one.state is None or one.state in FINAL else one.fraction for one in record.counts)
    return {
        "id": record.id,
        "name": record.name,
        "state": _state(record, counts, over == robots),
        "progress": Progress(fraction=ended / max(robots, 1), stage=f"{over} of {robots} robots"),
        "robots": robots,
        "counts": counts,
        "created_at": record.created_at,
        "finished_at": _finish_time(record) if over == robots else None,
    }


def _state(record: FleetRecord, counts: FleetCounts, over: bool) -> State:
    if not over:
        return "running" if counts.running or counts.succeeded or counts.failed else "queued"
    if record.cancelled_at is not None:
        return "cancelled"
    return "succeeded" if counts.succeeded else "failed"


def _finish_time(record: FleetRecord) -> datetime:
    """The last end of its jobs; where no robot got one it was over at once."""
    return max((one.finished_at for one in record.counts if one.finished_at is not None), default=record.created_at)


def _robot(one: FleetRobotRecord) -> FleetRobot:
    request, error, judged = one.request or {}, one.refusal or one.error, one.judged or {}
    compared = None if judged.get("compared") is None else as_written(Comparison, judged["compared"])
    held_out_before, held_out_after = _held_out(compared)
    return FleetRobot(
        robot=one.robot,
        state=one.state or "refused",
        job_id=one.job_id,
        campaigns=request.get("campaigns") or [],
        validation=request.get("validation"),
        version_before=one.before_id,
        version_id=one.version_id,
        held_out_before_mm=held_out_before,
        held_out_after_mm=held_out_after,
        compared=compared,
        objections=as_written(list[Objection], judged.get("objections") or []),
        warnings=as_written(list[Remark], judged.get("warnings") or []),
        error=None if error is None else JobError(code=error["code"], message=error["message"]),
    )


def _held_out(compared: Comparison | None) -> tuple[float | None, float | None]:
    """Mean errors before and after on the same poses; without a version before only after, on all that were held out."""
    if compared is None:
        return None, None
    if compared.active is None:
        return None, compared.mean_mm
    return compared.active.mean_mm, compared.active.mean_mm + compared.active.larger_by_mm
