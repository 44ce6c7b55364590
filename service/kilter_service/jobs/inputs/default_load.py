"""What a job says of a payload that its campaigns do not state: the robot's default load counted, or nothing."""

from __future__ import annotations

from typing import Any

from kilter_service.campaigns.unstated_load import REMEDY, counted_as_nothing
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.ground.core import core_effects
from kilter_service.jobs.kind import JobInput, JobOutput

READ = frozenset({"moments", "payload_kg"})
THESIS = ("clearance_tilt", "backlash_load", "axial_compliance")  # of level 3 without named effects


def with_load_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that a default load, or none, was taken, and for which campaigns."""
    remark = _default(job) or unstated_load_warning(kind, job)
    return output if remark is None else output.with_warnings(remark)


def unstated_load_warning(kind: str, job: JobInput) -> dict[str, Any] | None:
    """Say which campaigns state no payload, where nothing counted and an effect of the job follows the load; else None."""
    following = _following(kind, job) if job.no_load else []
    if not following:
        return None
    named = ", ".join(job.names.get(c, c) for c in job.no_load)
    several = len(job.no_load) > 1
    said = counted_as_nothing(f"{named} {'state' if several else 'states'}", following)
    return {
        "code": "load_not_stated",
        "message": f"{said} {REMEDY.format(whole='campaign')}",
        "campaigns": list(job.no_load),
        "effects": following,
    }


def _following(kind: str, job: JobInput) -> list[str]:
    """Effects that the job identifies, tests or carries, by id, that read the load."""
    reading = [
        e.id for e in core_effects.EFFECTS.values() if e.needs & READ and not e.nuisance and e.stage != "measurement"
    ]
    own = [] if job.calibration is None else [e.id for e in job.calibration.model.effects]
    if kind == "gap":
        asked = [str(e if isinstance(e, str) else e.id) for e in getattr(job.options, "effects", None) or ()]
        own += asked or (reading if job.robot.has_masses else [])
    elif kind == "identify":
        asked = [str(e if isinstance(e, str) else e.id) for e in job.options.effects]
        own = asked or (list(THESIS) if job.options.level == 3 and not own else own)
    elif not KINDS[kind].against_fit:
        return []
    return [name for name in dict.fromkeys(own) if name in reading]


def _default(job: JobInput) -> dict[str, Any] | None:
    load = job.robot.load
    if load is None or not job.default_load:
        return None
    at = ", ".join(f"{value * 1e3:.6g}" for value in load.com)
    return {
        "code": "default_load_used",
        "message": f"{', '.join(job.names.get(c, c) for c in job.default_load)}: no payload is stated, so the robot's default "
        f"load counts, {load.mass:.6g} kg at ({at}) mm in the tool frame. If it carried another, state payload_kg.",
        "campaigns": list(job.default_load),
    }
