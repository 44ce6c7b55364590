"""A version against which its own report speaks is unsure everywhere: files, streams and exports of it say so."""

from __future__ import annotations

from dataclasses import replace

from kilter_service.ground.core import core_doubts
from kilter_service.jobs.kind import JobInput, JobOutput
from kilter_service.versions.ability import CODE as CANNOT_CORRECT
from kilter_service.versions.objections import objections_from_report


def with_doubts(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to the version what its own report says against it, but for limits that are too small: its rows say that."""
    version = output.version
    if version is None:
        return output
    against = [one for one in objections_from_report(version.report, version.limits) if one.code != CANNOT_CORRECT]
    doubts = [core_doubts.Doubt.everywhere(job.robot.n_joints, 0.0, one.message).to_document() for one in against]
    if not doubts:
        return output
    document = {**version.calibration, "doubts": [*version.calibration.get("doubts", ()), *doubts]}
    return replace(output, version=replace(version, calibration=document))
