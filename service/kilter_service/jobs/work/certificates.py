"""What a job says of its instruments: whose certificate did not hold when a campaign was measured."""

from __future__ import annotations

from kilter_service.jobs.kind import JobInput, JobOutput


def with_certificate_warnings(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version what the certificates of the instruments have against the campaigns."""
    return output.with_warnings(
        *(
            {
                "code": one.code,
                "message": f"{job.names.get(campaign, campaign)}: {one.message}",
                "campaigns": [campaign],
            }
            for campaign, remarks in job.certificates.items()
            for one in remarks
        )
    )
