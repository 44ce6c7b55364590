"""The limits of the version that a job makes: those asked for, else what the version needs over the workspace."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from kilter_service.ground.core import core_model, predictive
from kilter_service.jobs.inputs.plain import to_json_types
from kilter_service.versions.suggested import WORKSPACE, suggest_limits

if TYPE_CHECKING:
    from kilter_service.jobs.kind import JobInput, JobOutput


def with_limits(output: JobOutput, job: JobInput) -> JobOutput:
    """Set the limits of the version, and say in its report what it does within them."""
    version = output.version
    if version is None:
        return output
    calibration = core_model.Calibration.from_document(job.robot, version.calibration)
    known = predictive.Predictive.from_document(version.covariance, version.report)
    limits, workspace = suggest_limits(calibration, known, version.limits)
    report = {**version.report, WORKSPACE: to_json_types(workspace)}
    return replace(output, version=replace(version, limits=limits, report=report))
