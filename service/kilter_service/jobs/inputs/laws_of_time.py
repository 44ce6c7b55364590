"""What a job says of laws of time that campaigns do without: they hold on the clock that they were fitted on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kilter_service.ground.core import core_model, other_campaigns
from kilter_service.jobs.kind import JobInput, JobOutput

if TYPE_CHECKING:
    from kilter_core.errors import Finding
    from kilter_core.observations import Observations


def with_clock_warnings(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version which laws of time were not applied to which campaigns: those held out, or all of a check."""
    held = {c: rows for c, rows in job.rows_by_campaign.items() if c not in job.campaigns}
    if output.version is not None and held:
        made = core_model.Calibration.from_document(job.robot, output.version.calibration)
        output = output.with_warnings(*clock_remarks(made, held, job.names))
    anew = {c: rows for c, rows in job.campaigns.items() if c not in job.made_from}
    continued = output.version is not None and len(anew) < len(job.campaigns)
    if job.calibration is None or continued:
        return output
    return output.with_warnings(*clock_remarks(job.calibration, anew, job.names))


def clock_remarks(
    calibration: core_model.Calibration, rows: dict[str, Observations], names: dict[str, str]
) -> list[dict[str, Any]]:
    """Return which laws of a version each campaign does without, the campaigns of one reason together."""
    found: dict[tuple[str, ...], tuple[Finding, list[str]]] = {}
    for campaign, seen in rows.items():
        for one in other_campaigns.carried_findings(calibration.model.effects, seen):
            reason = (one.code, one.only_said["laws"], one.only_said["steps"])
            found.setdefault(reason, (one, []))[1].append(campaign)
    return [
        {
            **one.to_document(other_campaigns.SENTENCES),
            "campaigns": campaigns,
            "message": f"{', '.join(names.get(c, c) for c in campaigns)}: {one.message(other_campaigns.SENTENCES)}",
        }
        for one, campaigns in found.values()
    ]
