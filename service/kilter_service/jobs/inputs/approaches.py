"""What a job says where nobody stated from which side joints came, and the order of the rows tells it."""

from __future__ import annotations

from kilter_service.ground.core import core_model
from kilter_service.jobs.kind import JobInput, JobOutput

NEEDED = "direction"


def with_direction_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that directions were derived, where the job looked at directions."""
    derived = [campaign for campaign, rows in job.rows_by_campaign.items() if rows.directions_derived]
    if not derived or not (kind == "gap" or _follows_directions(output, job)):
        return output
    names = ", ".join(job.names.get(campaign, campaign) for campaign in derived)
    said = (
        f"{names}: directions were derived from the order of the rows. State dir1 ... where another order was driven."
    )
    return output.with_warnings({"code": "directions_derived", "message": said, "campaigns": derived})


def _follows_directions(output: JobOutput, job: JobInput) -> bool:
    """Whether an effect of the version made, else of the version used, depends on the side a joint came from."""
    if output.version is None:
        return job.calibration is not None and NEEDED in job.calibration.model.needs
    return NEEDED in core_model.Calibration.from_document(job.robot, output.version.calibration).model.needs
