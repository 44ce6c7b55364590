"""Job kind ``motion_plan``: motions that show bodies and friction, to be recorded with their torques."""

from __future__ import annotations

import numpy as np

from kilter_service.contract.jobs.motion_plan import MOTION_PLAN, MotionPlanOptions
from kilter_service.ground.core import core_motion
from kilter_service.ground.wire import joint_scale, joint_units, to_metres, to_rad
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, Progress
from kilter_service.jobs.kinds.plan import UNCHECKED
from kilter_service.jobs.setups import to_json_types
from kilter_service.jobs.torque_inputs import joint_columns

DIGITS = "%.5f"


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Choose motions within the limits of the robot's joints."""
    options: MotionPlanOptions = job.options
    speed = to_rad(options.speed_deg_s), to_metres(options.speed_mm_s)
    made = core_motion.plan_motions(
        job.robot, options.seconds, options.count, options.rate_hz, speed, options.seed, progress
    )
    scale, units = np.array(joint_scale(job.robot)), joint_units(job.robot)
    q = made.q * scale
    lines = [",".join(["t_s", *joint_columns(job.robot)])]
    lines += [",".join(DIGITS % value for value in row) for row in np.column_stack([made.t, q]).tolist()]
    joints = [
        {"joint": j + 1, "unit": unit, "lowest": q[:, j].min(), "highest": q[:, j].max(), "fastest": fastest}
        for j, (unit, fastest) in enumerate(zip(units, made.fastest * scale, strict=True))
    ]
    result = {
        "count": options.count,
        "seconds": made.t[-1],
        "base_parameters": made.base,
        "condition": made.condition,
        "joints": joints,
        "csv": "\n".join([*lines, ""]),
        "warnings": [UNCHECKED],
    }
    return JobOutput(to_json_types(result))


KIND = JobKind(MOTION_PLAN, run)
