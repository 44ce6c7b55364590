"""Job kind ``payload``: what an arm carries, from torques with it and without it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.parameters import mm
from kilter_service.contract.jobs.payload import PAYLOAD, PayloadOptions
from kilter_service.ground.core import core_motion
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Progress
from kilter_service.jobs.setups import to_json_types

if TYPE_CHECKING:
    from kilter_core.motion import CarriedBody

COVERED = 1.96  # standard deviations of half a 95 % interval


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Weigh what is carried in the campaigns that are not named as empty."""
    empty = _empty_campaigns(job)
    loaded = [rows for campaign, rows in job.campaigns.items() if campaign not in empty]
    progress(0.1, "fitting both logs")
    found = core_motion.weigh_payload(job.robot, loaded, [job.campaigns[campaign] for campaign in empty])
    return JobOutput(to_json_types(_to_document(job, found)))


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Say which rows would be fitted, and refuse campaigns that do not go together."""
    found.count_fitted_rows(*job.campaigns.values())
    with found.noting_refusals():
        _empty_campaigns(job)


def _empty_campaigns(job: JobInput) -> list[str]:
    """Campaigns, by id, that the options name as empty."""
    options: PayloadOptions = job.options
    if len(job.campaigns) < 2:
        raise OptionError(
            "A payload is weighed by two campaigns: name the one with the load, then the one without it.",
            option="empty",
        )
    ids = {name: campaign for campaign, name in job.names.items()} | {campaign: campaign for campaign in job.campaigns}
    named = options.empty or [*job.campaigns][-1:]
    for name in named:
        if ids.get(name) not in job.campaigns:
            raise OptionError(
                f"empty names {name!r}, which is not a campaign of this job: name both, the one with the load and the one "
                "without it.",
                option="empty",
            )
    empty = list(dict.fromkeys(ids[name] for name in named))
    if len(empty) == len(job.campaigns):
        raise OptionError("All campaigns are named as empty: name one with the load too.", option="empty")
    return empty


def _to_document(job: JobInput, found: CarriedBody) -> dict[str, Any]:
    known = bool(np.isfinite(found.centre).all())
    joints = [
        {
            "joint": j + 1,
            "unit": "N m" if joint.kind == "revolute" else "N",
            "empty_arm": found.left[0][j],
            "with_load": found.left[1][j],
        }
        for j, joint in enumerate(job.robot.joints)
    ]
    return {
        "mass_kg": max(found.mass, 0.0),
        "mass_u95_kg": COVERED * found.mass_sigma,
        "centre_mm": mm(found.centre) if known else None,
        "centre_u95_mm": COVERED * mm(found.centre_sigma) if known else None,
        "inertia_kg_m2": found.inertia if known else None,
        "inertia_u95_kg_m2": COVERED * found.inertia_sigma if known else None,
        "joints": joints,
    }


KIND = JobKind(PAYLOAD, run, preview_job=preview_job)
