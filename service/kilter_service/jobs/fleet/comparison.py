"""How the version that a job of a fleet made compares with the one before, as its activation would find."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kilter_core.errors import CoreError
from kilter_service.contract.jobs.identify import IdentifyOptions
from kilter_service.ground.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.jobs.fleet import store
from kilter_service.jobs.kind import VersionContent
from kilter_service.jobs.records import JobRecord, UsedRecord
from kilter_service.versions.guard import judge_unstored
from kilter_service.versions.store import Training


def compare_with_previous(
    database: Database, job_id: str, version: VersionContent | None, used: Sequence[UsedRecord]
) -> dict[str, Any] | None:
    """Return what the fleet's report says of a version that is not stored yet; None: its job is of no fleet job."""
    if version is None:
        return None
    with database.reading() as session:
        found = store.version_before_fleet_job(session, job_id)
        job = jobs.get(session, job_id)
    if found is None:
        return None
    try:
        verdict = judge_unstored(
            database, job.robot_id, version.calibration, version.report, version.limits, _training(job, used), found[0]
        )
    except CoreError as error:  # the version counts without it
        return {"warnings": [{"code": error.code, "message": error.message}]}
    return {
        "compared": None if verdict.compared is None else verdict.compared.model_dump(mode="json"),
        "objections": [one.model_dump(mode="json") for one in verdict.objections],
        "warnings": list(verdict.warnings),
    }


def _training(job: JobRecord, used: Sequence[UsedRecord]) -> Training:
    """What the version is fitted to, as it will be known when it is stored."""
    held = job.request.validation
    campaigns = tuple(dict.fromkeys((one.id, tuple(one.sha256)) for one in used if one.use == "train"))
    seed = int(job.request.options.get("seed", IdentifyOptions.model_fields["seed"].default))
    return Training(job.kind, campaigns, held if isinstance(held, float) and held > 0.0 else None, seed)
