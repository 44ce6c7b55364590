"""What a job says of its instruments: whose certificate did not hold when a campaign was measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kilter_service.jobs.kind import JobInput, JobOutput


def with_certificate_warnings(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version what the certificates of the instruments have against the campaigns."""
    if not job.certificates:
        return output
    version = output.version
    return replace(
        output,
        result=_added(output.result, job),
        version=None if version is None else replace(version, report=_added(version.report, job)),
    )


def _added(document: dict[str, Any], job: JobInput) -> dict[str, Any]:
    said = [
        {"code": one.code, "message": f"{job.names.get(campaign, campaign)}: {one.message}", "campaigns": [campaign]}
        for campaign, remarks in job.certificates.items()
        for one in remarks
    ]
    return {**document, "warnings": [*(document.get("warnings") or []), *said]}
