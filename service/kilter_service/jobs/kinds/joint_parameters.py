"""Job kind ``joint_parameters``: from inclinometer readings, or from link-side encoders; or where to take readings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import FindingDocument, OptionError
from kilter_core.observations import Observations
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.contract.jobs.joint_parameters import JOINT_PARAMETERS
from kilter_service.contract.jobs.joint_parameters import JointParametersOptions as Options
from kilter_service.ground.core import core_plan, core_procedures
from kilter_service.ground.wire import joint_scale, joint_scale_back, joint_units, to_deg, to_metres, to_rad
from kilter_service.jobs.kind import JobInput, JobKind, JobOutput, JobPreview, Lack, Progress, VersionContent

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.model import Calibration
    from kilter_core.procedures import JointParameter, LinkJoint, Log

AXES = "xyz"
REMEDY = (
    "Read the joint in the configurations that `propose` names, or move it while its link-side encoder is recorded."
)
AT_THE_TOOL = (0.0, 0.0, 0.0)


def check(options: Options) -> None:
    """Refuse options that do not go together.

    Raises:
        OptionError: both readings and a joint.

    """
    if options.readings and options.propose is not None:
        raise OptionError("Give either `readings`, or in `propose` the joint to plan readings for.", option="readings")


def run(job: JobInput, progress: Progress) -> JobOutput:
    """Measure the joints of the readings or of the campaigns, or propose configurations for one joint."""
    options: Options = job.options
    if options.propose is not None:
        progress(0.1, "choosing configurations")
        return JobOutput({"joint": options.propose, **_propose_configurations(job.robot, options)})
    progress(0.1, "fitting joints")
    return _estimate_from_measurements(job)


def _estimate_from_measurements(job: JobInput) -> JobOutput:
    """Measure by what there is: readings given, or campaigns with inclinometers or link-side encoders."""
    if not job.campaigns:
        return _by_inclinometers(job.robot, _log(job.robot, job.options))
    if not any(rows.tilt is not None for rows in job.campaigns.values()):
        return _by_encoders(job)
    return _by_inclinometers(job.robot, _log_of_campaigns(job))


def preview_job(job: JobInput, found: JobPreview) -> None:
    """Measure the joints, which takes no time, and say what could not be determined."""
    options: Options = job.options
    found.count_fitted_rows(*job.campaigns.values())
    if isinstance(job.validation, dict):
        found.hold("campaigns", *job.validation.values())
    with found.noting_refusals():
        if options.propose is not None:
            _joint(job.robot, options.propose)
            return
        if not job.campaigns:
            found.rows = len(options.readings)
        measured = _estimate_from_measurements(job)
        told = measured.result["parameters"]
        found.missing += [Lack(p["name"], p["reason"], REMEDY) for p in told if "reason" in p]
        found.missing += [Lack(w.get("joint", w["code"]), w["message"], REMEDY) for w in measured.result["warnings"]]


def _log_of_campaigns(job: JobInput) -> core_procedures.Log:
    """Readings of all campaigns, mountings numbered apart."""
    encoders = [name for name, rows in job.campaigns.items() if rows.link_q is not None or rows.tilt is None]
    if encoders:
        raise OptionError(
            f"Campaign {encoders[0]} holds link-side encoders or no inclinometer, others hold inclinometers: make two jobs.",
            option="campaigns",
        )
    if job.validation is not None:
        raise OptionError("Readings of inclinometers are not held out: leave validation out.", option="validation")
    parts = [
        rows if rows.session is not None else replace(rows, session=np.zeros(len(rows), dtype=np.int64))
        for rows in job.campaigns.values()
    ]
    return core_procedures.Log.from_observations(
        Observations.concatenate(renumber_poses_and_sessions(parts)), to_rad(job.options.resolution_deg)
    )


def _by_inclinometers(robot: Robot, log: Log) -> JobOutput:
    found, warnings = core_procedures.joint_parameters(robot, log)
    warnings += [_at_the_tool(robot.joints[j].name) for j in core_procedures.weightless_joints(robot)]
    result = {"measured_by": "inclinometer", "parameters": [_row(p) for p in found], "warnings": warnings}
    return JobOutput(result, _content(core_procedures.calibration_from_inclinations(robot, found), found, result))


def _by_encoders(job: JobInput) -> JobOutput:
    if job.validation is not None and not isinstance(job.validation, dict):
        raise OptionError("Name campaigns in validation: motions are held out whole.", option="validation")
    held = job.validation or {}
    found = core_procedures.link_joints(job.robot, list(job.campaigns.values()), list(held.values()))
    rows = [p for joint in found for p in joint.parameters]
    result: dict[str, Any] = {
        "measured_by": "link-side encoder",
        "parameters": [_row(p) for p in rows],
        "joints": [_spreads(job.robot, joint, list(job.campaigns), list(held)) for joint in found],
        "warnings": [_dead(job.robot, joint) for joint in found if joint.dead is not None],
    }
    return JobOutput(result, _content(core_procedures.calibration_from_encoders(job.robot, found), rows, result))


def _content(calibration: Calibration, found: list[JointParameter], result: dict[str, Any]) -> VersionContent:
    told = [p for p in found if p.sigma is not None and p.name in calibration.names]
    matrix = [[float(p.sigma or 0.0) ** 2 if p is other else 0.0 for other in told] for p in told]
    return VersionContent(
        calibration.to_document(), result, {"names": [p.name for p in told], "matrix": matrix, "units": "SI"}
    )


def _spreads(robot: Robot, joint: LinkJoint, fitted: list[str], predicted: list[str]) -> dict[str, Any]:
    """Standard deviation of link minus motor angle in degrees, before and after, for every motion of the joint."""
    none = joint.dead is not None
    motions = [("fitted", c, s) for c, s in zip([] if none else fitted, joint.fitted, strict=True)]
    motions += [("predicted", c, s) for c, s in zip([] if none else predicted, joint.predicted, strict=True)]
    return {
        "joint": robot.joints[joint.joint].name,
        "dead": joint.dead,
        "motions": [
            {"campaign": campaign, "use": use, "raw_deg": to_deg(s.raw), "left_deg": to_deg(s.left)}
            for use, campaign, s in motions
            if s is not None
        ],
    }


def _dead(robot: Robot, joint: LinkJoint) -> dict[str, str]:
    code = "dead_encoder" if "dead" in str(joint.dead) else "joint_never_moves"
    return FindingDocument.make(
        code, f"Nothing is known of this joint: {joint.dead}.", joint=robot.joints[joint.joint].name
    )


def _at_the_tool(name: str) -> dict[str, str]:
    return FindingDocument.make(
        "joint_without_gravity",
        f"Gravity exerts no moment about joint {name}, so no inclinometer can measure its backlash and stiffness: "
        "measure tool positions reached from both sides, and under a sideways force, and identify them (thesis 4.4.1).",
        joint=name,
    )


def _joint(robot: Robot, name: str) -> int:
    names = [joint.name for joint in robot.joints]
    if name not in names:
        raise OptionError(f"The robot has no joint {name!r}. It has: {', '.join(names)}.", option="joint")
    return names.index(name)


def _log(robot: Robot, options: Options) -> core_procedures.Log:
    for number, reading in enumerate(options.readings):
        if len(reading.q_deg) != robot.n_joints:
            raise OptionError(
                f"Reading {number + 1} has {len(reading.q_deg)} joint values, the robot {robot.n_joints}.",
                option="q_deg",
            )
    return core_procedures.Log(
        q=np.array([r.q_deg for r in options.readings]) * joint_scale_back(robot),
        joint=np.array([_joint(robot, r.joint) for r in options.readings], dtype=np.int64),
        axis=np.array([AXES.index(r.axis) for r in options.readings], dtype=np.int64),
        reading=to_rad(np.array([r.reading_deg for r in options.readings])),
        payload_kg=np.array([r.payload_kg for r in options.readings]),
        payload_com=to_metres(np.array([r.payload_com_mm or AT_THE_TOOL for r in options.readings])),
        series=np.array([r.series for r in options.readings], dtype=np.int64),
        resolution=to_rad(options.resolution_deg),
    )


def _propose_configurations(robot: Robot, options: Options) -> dict[str, Any]:
    """Configurations to read, and the same as a table to fill in."""
    joint = _joint(robot, str(options.propose))
    scale = joint_scale(robot)
    configurations: list[dict[str, Any]] = []
    com = options.payload_com_mm or AT_THE_TOOL
    centre = [f"payload_com_{axis}_mm" for axis in AXES] if options.payload_com_mm is not None else []
    joints = [f"q{i}_{unit}" for i, unit in enumerate(joint_units(robot), 1)]
    lines = [",".join(["joint", "axis", *joints, "payload_kg", *centre, "series", "reading_deg"])]
    at = [to_metres(value) for value in com]
    for c in core_plan.inclinometer_poses(robot, joint, options.count, options.payloads_kg, options.seed, at):
        q = [float(v) * k for v, k in zip(c.q, scale, strict=True)]
        axis = AXES[c.axis]
        configurations.append({"joint": options.propose, "axis": axis, "payload_kg": c.payload_kg, "q_deg": q})
        configurations[-1] |= {} if options.payload_com_mm is None else {"payload_com_mm": list(com)}
        load = [f"{v:g}" for v in (c.payload_kg, *(com if options.payload_com_mm is not None else ()))]
        lines.append(",".join([str(options.propose), axis, *(f"{v:.4f}" for v in q), *load, "0", ""]))
    return {"configurations": configurations, "csv": "\n".join(lines) + "\n"}


def _row(p: JointParameter) -> dict[str, Any]:
    """A parameter in degrees; the stiffness of a joint is given with its compliance."""
    scale = 1.0 if p.unit == "s" else to_deg(1.0)
    row: dict[str, Any] = {
        "name": p.name,
        "unit": p.unit.replace("rad", "deg"),
        "readings": p.readings,
        "identifiable": p.value is not None,
        "value": None if p.value is None else p.value * scale,
        "sigma": None if p.sigma is None else p.sigma * scale,
    }
    row |= {"nominal": 0.0, "change": row["value"]}  # a nominal joint has neither backlash nor compliance
    if p.reason is not None:
        row["reason"] = p.reason
    if p.name.startswith("compliance") and p.value:
        row["stiffness_nm_deg"] = 1.0 / (p.value * scale)
    return row


KIND = JobKind(JOINT_PARAMETERS, run, check, preview_job=preview_job)
