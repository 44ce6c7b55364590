"""Job kind ``joint_parameters``: clearance, backlash and stiffness from inclinometer readings, or where to take them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from core.errors import OptionError
from service.jobs.kind import JobInput, JobKind, JobOutput, Progress, VersionContent

if TYPE_CHECKING:
    from core.inclinometers import JointParameter, Log
    from core.robot import Robot

AXES = "xyz"
RESOLUTION_DEG = 0.001
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Reading(BaseModel):
    """One reading: what the joint turned about an axis of its frame beyond the command, up to a constant per series."""

    model_config = ConfigDict(extra="forbid")

    joint: str
    axis: Literal["x", "y", "z"]
    q_deg: list[Finite]
    reading_deg: Finite
    payload_kg: Annotated[float, Field(ge=0)] = 0.0
    series: int = 0


class Options(BaseModel):
    """Readings to evaluate, or a joint to propose configurations for. ``q_deg`` of a slide is in mm."""

    model_config = ConfigDict(extra="forbid")

    readings: list[Reading] = []
    resolution_deg: Annotated[float, Field(gt=0)] = RESOLUTION_DEG
    propose: str | None = None
    count: Annotated[int, Field(ge=4, le=200)] = 8
    payloads_kg: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)] = [0.0]
    seed: Annotated[int, Field(ge=0)] = 0


def check(options: dict[str, Any]) -> None:
    """Refuse options that joint_parameters does not have.

    Raises:
        OptionError: one that does not exist or cannot be, or neither readings nor a joint.

    """
    _read(options)


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Measure the joints of the readings, or propose configurations for one joint."""
    options = _read(job.options)
    if options.propose is not None:
        progress(0.1, "choosing configurations")
        return JobOutput({"joint": options.propose, "configurations": _proposed(job.robot, options)})
    from core.inclinometers import as_calibration, joint_parameters

    progress(0.1, "fitting joints")
    found, warnings = joint_parameters(job.robot, _log(job.robot, options))
    result = {"parameters": [_row(p) for p in found], "warnings": warnings}
    told = [p for p in found if p.sigma is not None]
    matrix = [[float(p.sigma or 0.0) ** 2 if p is other else 0.0 for other in told] for p in told]
    covariance = {"names": [p.name for p in told], "matrix": matrix, "units": "SI"}
    return JobOutput(result, VersionContent(as_calibration(job.robot, found).to_document(), result, covariance))


def _read(options: dict[str, Any]) -> Options:
    try:
        read = Options.model_validate(options)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise OptionError(f"options.{place}: {first['msg']}.", option=place) from error
    if bool(read.readings) == (read.propose is not None):
        raise OptionError("Give either `readings`, or in `propose` the joint to plan readings for.", option="readings")
    return read


def _joint(robot: Robot, name: str) -> int:
    names = [joint.name for joint in robot.joints]
    if name not in names:
        raise OptionError(f"The robot has no joint {name!r}. It has: {', '.join(names)}.", option="joint")
    return names.index(name)


def _log(robot: Robot, options: Options) -> Log:
    import numpy as np

    from core.inclinometers import Log

    for number, reading in enumerate(options.readings):
        if len(reading.q_deg) != robot.n_joints:
            raise OptionError(
                f"Reading {number + 1} has {len(reading.q_deg)} joint values, the robot {robot.n_joints}.",
                option="q_deg",
            )
    scale = np.array([math.pi / 180.0 if joint.kind == "revolute" else 1e-3 for joint in robot.joints])
    return Log(
        q=np.array([r.q_deg for r in options.readings]) * scale,
        joint=np.array([_joint(robot, r.joint) for r in options.readings], dtype=np.int64),
        axis=np.array([AXES.index(r.axis) for r in options.readings], dtype=np.int64),
        reading=np.radians([r.reading_deg for r in options.readings]),
        payload_kg=np.array([r.payload_kg for r in options.readings]),
        series=np.array([r.series for r in options.readings], dtype=np.int64),
        resolution=math.radians(options.resolution_deg),
    )


def _proposed(robot: Robot, options: Options) -> list[dict[str, Any]]:
    from core.design.inclinometer_poses import inclinometer_poses

    joint = _joint(robot, str(options.propose))
    scale = [180.0 / math.pi if j.kind == "revolute" else 1e3 for j in robot.joints]
    return [
        {"joint": options.propose, "axis": AXES[c.axis], "payload_kg": c.payload_kg,
         "q_deg": [float(v) * k for v, k in zip(c.q, scale, strict=True)]}
        for c in inclinometer_poses(robot, joint, options.count, options.payloads_kg, options.seed)
    ]  # fmt: skip


def _row(p: JointParameter) -> dict[str, Any]:
    """A parameter in degrees; the stiffness of a joint stands beside its compliance."""
    scale = 180.0 / math.pi
    row: dict[str, Any] = {
        "name": p.name, "unit": p.unit.replace("rad", "deg"), "readings": p.readings, "identifiable": p.value is not None,
        "value": None if p.value is None else p.value * scale, "sigma": None if p.sigma is None else p.sigma * scale,
    }  # fmt: skip
    if p.reason is not None:
        row["reason"] = p.reason
    if p.name.startswith("compliance") and p.value:
        row["stiffness_nm_deg"] = 1.0 / (p.value * scale)
    return row


JOINT_PARAMETERS = JobKind("joint_parameters", check, run, needs_campaigns=False, takes_folds=False)
