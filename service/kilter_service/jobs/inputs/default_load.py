"""What a job says of the loads behind it: a payload that its campaigns do not state, and masses that came from torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from kilter_core.errors import Finding, Sentences
from kilter_service.campaigns.unstated_load import REMEDY, counted_as_nothing
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.ground.core import core_effects, core_observations
from kilter_service.jobs.kind import JobInput, JobOutput

READ = frozenset({"moments", "payload_kg"})
THESIS = ("clearance_tilt", "backlash_load", "axial_compliance")  # of level 3 without named effects


def with_load_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that a default load, or none, was taken, and for which campaigns."""
    found = _default_load(job) or find_unstated_load(kind, job)
    output = _with_masses_source(kind, output, job)
    return output if found is None else output.with_warnings(found.to_document(SENTENCES))


def _with_masses_source(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version which search in torques its masses are from, or that it took none of them."""
    if job.masses_from is None or output.result.get("motion"):
        return output
    masses = output.result.get("masses", {"carried": True})  # a search carries them
    if not _following(kind, job) or not (masses or {}).get("carried"):
        return output.with_warnings(Finding("options_unused", {}).to_document(SENTENCES))
    source = {"masses_from": job.masses_from}
    version = output.version and replace(output.version, report=output.version.report | source)
    return JobOutput(output.result | source, version)


def find_unstated_load(kind: str, job: JobInput) -> Finding | None:
    """Say which campaigns state no payload, where nothing counted and an effect of the job follows the load; else None."""
    if all(core_observations.is_log(rows) for rows in job.campaigns.values()):
        return None  # what it carries is part of the last body
    following = _following(kind, job) if job.no_load else []
    if not following:
        return None
    names = [job.names.get(c, c) for c in job.no_load]
    return Finding("load_not_stated", {"campaigns": list(job.no_load), "effects": following}, {"names": names})


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


def _default_load(job: JobInput) -> Finding | None:
    load = job.robot.load
    if load is None or not job.default_load:
        return None
    names = [job.names.get(c, c) for c in job.default_load]
    said = {"names": names, "mass_kg": load.mass, "com_m": load.com}
    return Finding("default_load_used", {"campaigns": list(job.default_load)}, said)


def load_not_stated(said: Mapping[str, Any]) -> str:
    """Say which campaigns state no payload, and which effects follow it."""
    state = "state" if len(said["campaigns"]) > 1 else "states"
    return counted_as_nothing(f"{', '.join(said['names'])} {state}", said["effects"])


def _default_load_used(said: Mapping[str, Any]) -> str:
    at = ", ".join(f"{value * 1e3:.6g}" for value in said["com_m"])
    return (
        f"{', '.join(said['names'])}: no payload is stated, so the robot's default load counts, {said['mass_kg']:.6g} kg at "
        f"({at}) mm in the tool frame. If it carried another, state payload_kg."
    )


SENTENCES: Sentences = {
    "load_not_stated": lambda said: f"{load_not_stated(said)} {REMEDY.format(whole='campaign')}",
    "default_load_used": _default_load_used,
    "options_unused": lambda _: (
        "masses_from did nothing: no effect of this fit follows the load of links. Leave it out, or name such an effect "
        "(axial_compliance)."
    ),
}
