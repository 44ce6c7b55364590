"""What a job says when the version it made cannot correct the poses that it was made from."""

from __future__ import annotations

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.observations.spread import evenly
from kilter_service.ground.core import core_model
from kilter_service.jobs.kind import JobInput, JobOutput
from kilter_service.versions import ability
from kilter_service.versions.predictions import preview

CAUSES = {"board_scale_differs", "camera_moved"}  # that wider limits or zeros entered in the controller do not mend
MOST_POSES = 500  # looked at, evenly chosen


def with_ability_warning(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that it refuses too many poses, with what helps; activation looks again."""
    version = output.version
    if version is None or not job.campaigns:
        return output
    if any(one.get("code") in CAUSES for one in version.report.get("warnings") or ()):
        return output
    q = np.concatenate([rows.q for rows in job.campaigns.values()])
    q = q[evenly(len(q), MOST_POSES)]
    calibration = core_model.Calibration.from_document(job.robot, version.calibration)
    try:
        found = preview.at_poses(calibration, None, version.limits, q)
        objection = ability.of_poses(calibration, found, version.limits)
    except (CoreError, ArithmeticError, ValueError):  # activation says so
        return output
    return output if objection is None else output.with_warnings(objection.model_dump())
