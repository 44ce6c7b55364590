"""What a job says when the robot's default load replaced a payload that its campaigns do not state."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kilter_service.jobs.kind import JobInput, JobOutput


def with_load_warning(output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that the default load was taken, and for which campaigns."""
    load = job.robot.load
    if load is None or not job.default_load:
        return output
    at = ", ".join(f"{value * 1e3:.6g}" for value in load.com)
    remark = {
        "code": "default_load_used",
        "message": f"{', '.join(job.names.get(c, c) for c in job.default_load)}: no payload is stated, so the robot's default "
        f"load counts, {load.mass:.6g} kg at ({at}) mm in the tool frame. If it carried another, state payload_kg.",
        "campaigns": list(job.default_load),
    }
    version = output.version
    return replace(
        output,
        result=with_remark(output.result, remark),
        version=None if version is None else replace(version, report=with_remark(version.report, remark)),
    )


def with_remark(document: dict[str, Any], remark: dict[str, Any]) -> dict[str, Any]:
    """A document with one more warning, unless one of its code is there."""
    said = document.get("warnings") or []
    return (
        document
        if any(one.get("code") == remark["code"] for one in said)
        else {**document, "warnings": [*said, remark]}
    )
