"""Job kind ``payload``: what an arm carries, from torques with it and without it, or from a force sensor at the wrist."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import metres, mm
from kilter_service.contract.jobs.payload import PAYLOAD, PayloadOptions
from kilter_service.ground.core import core_motion
from kilter_service.ground.wire import to_deg
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Progress
from kilter_service.jobs.setups import to_json_types

if TYPE_CHECKING:
    from kilter_core.motion import CarriedBody, WristReading

COVERED = 1.96  # standard deviations of half a 95 % interval
MOST_ROWS = 20_000  # of the wrench without gravity


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Weigh what is carried in the campaigns that are not named as empty, or in all by a force sensor."""
    if _choose_scales(job) == "wrench":
        progress(0.1, "fitting gravity")
        at = job.options.sensor_mm
        found = core_motion.read_wrist(
            job.robot, _join_readings(job), None if at is None else np.array([metres(x) for x in at])
        )
        return JobOutput(to_json_types(_describe_body(found.body) | _describe_sensor(found)))
    empty = _empty_campaigns(job)
    loaded = [rows for campaign, rows in job.campaigns.items() if campaign not in empty]
    progress(0.1, "fitting both logs")
    body = core_motion.weigh_payload(job.robot, loaded, [job.campaigns[campaign] for campaign in empty])
    return JobOutput(to_json_types(_describe_body(body) | {"joints": _describe_torques(job, body)}))


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Say which rows would be fitted, and refuse campaigns that do not go together."""
    found.count_fitted_rows(*job.campaigns.values())
    with found.noting_refusals():
        if _choose_scales(job) == "torques":
            _empty_campaigns(job)


def _choose_scales(job: JobInput) -> str:
    """What weighs: as asked, else what the campaigns have.

    Raises:
        OptionError: they have torques and a wrench, which may be a sensor's reading or a known load.

    """
    options: PayloadOptions = job.options
    rows = job.campaigns.values()
    wrench = all(one.wrench is not None for one in rows)
    if options.by is None and wrench and any(one.tau is not None for one in rows):
        raise OptionError(
            "These campaigns have joint torques and fx_n ... mz_nm. Say which weighs: by torques, or by wrench if a force "
            "sensor at the wrist read them.",
            option="by",
        )
    scales = options.by or ("wrench" if wrench else "torques")
    if scales == "wrench" and options.empty:
        raise OptionError(
            "A force sensor weighs by itself: leave empty out, and name its campaigns only.", option="empty"
        )
    if scales == "torques" and options.sensor_mm is not None:
        raise OptionError(
            "sensor_mm is the place of a force sensor: say by wrench, or leave it out.", option="sensor_mm"
        )
    return scales


def _join_readings(job: JobInput) -> Observations:
    """Joints, clocks and wrenches of all campaigns; each begins anew."""
    parts = list(job.campaigns.values())
    timed = all(one.t is not None for one in parts)
    return Observations.concatenate(
        [
            Observations(q=one.q, t=one.t if timed else None, wrench=one.wrench, session=np.full(len(one), k))
            for k, one in enumerate(parts)
        ]
    )


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


def _describe_body(found: CarriedBody) -> dict[str, Any]:
    known, solid = bool(np.isfinite(found.centre).all()), bool(np.isfinite(found.inertia).all())
    return {
        "mass_kg": max(found.mass, 0.0),
        "mass_u95_kg": COVERED * found.mass_sigma,
        "centre_mm": mm(found.centre) if known else None,
        "centre_u95_mm": COVERED * mm(found.centre_sigma) if known else None,
        "inertia_kg_m2": found.inertia if solid else None,
        "inertia_u95_kg_m2": COVERED * found.inertia_sigma if solid else None,
    }


def _describe_torques(job: JobInput, found: CarriedBody) -> list[dict[str, Any]]:
    return [
        {
            "joint": j + 1,
            "unit": "N m" if joint.kind == "revolute" else "N",
            "empty_arm": found.left[0][j],
            "with_load": found.left[1][j],
        }
        for j, joint in enumerate(job.robot.joints)
    ]


def _describe_sensor(found: WristReading) -> dict[str, Any]:
    rotated = COVERED * to_deg(found.mounting_sigma)
    left = np.sqrt(np.mean(found.left.reshape(2, 3) ** 2, axis=1))
    step = -(-len(found.at) // MOST_ROWS)
    rows = np.column_stack([found.at, found.free])[::step]
    lines = [",".join(f"{cell:.7g}" for cell in row) for row in rows.tolist()]
    head = f"{'t_s' if found.moving else 'row'},fx_n,fy_n,fz_n,mx_nm,my_nm,mz_nm"
    return {
        "sensor": {
            "bias_n": found.bias[:3],
            "bias_u95_n": COVERED * found.bias_sigma[:3],
            "bias_nm": found.bias[3:],
            "bias_u95_nm": COVERED * found.bias_sigma[3:],
            "mounting_deg": to_deg(found.mounting),
            "mounting_u95_deg": rotated if np.isfinite(rotated).all() else None,
            "left_n": left[0],
            "left_nm": left[1],
            "touched_rows": int(found.touched.sum()),
        },
        "csv": "\n".join([head, *lines]) + "\n",
        "warnings": list(_list_warnings(found)),
    }


def _list_warnings(found: WristReading) -> Iterator[dict[str, Any]]:
    if not np.isfinite(found.mounting_sigma).all():
        message = (
            "Gravity rotated in a plane only, so the axes of the sensor are taken for those of the flange. Rotate the wrist "
            "about two axes to have them measured."
        )
        yield {"code": "sensor_axes_believed", "message": message}
    if touched := int(found.touched.sum()):
        first = found.at[found.touched][0]
        where = f"at t_s {first:.0f}" if found.moving else f"row {first:.0f}"
        message = (
            f"Something else touched the tool in {touched} of {len(found.at)} rows, first {where}: they were left out of the "
            "fit. What it did is in the wrench without gravity."
        )
        yield {"code": "tool_touched", "message": message}


KIND = JobKind(PAYLOAD, run, preview_job=preview_job)
