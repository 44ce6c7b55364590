"""Logs of joint torques for a job, and planned poses as a document and a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.types import Floats
from kilter_service.campaigns.store import renumber_poses_and_sessions
from kilter_service.ground.core import core_motion, core_observations
from kilter_service.ground.wire import joint_scale, joint_units, to_mm
from kilter_service.jobs.kind import JobInput, JobOutput, Progress
from kilter_service.jobs.setups import to_json_types

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.observations import Observations


READ = ("effects", "seed", "start")  # with a start, a version is made of it and the torques


def as_session(rows: Observations) -> Observations:
    """A campaign without sessions is one of its own."""
    return rows if rows.session is not None else replace(rows, session=np.zeros(len(rows), dtype=np.int64))


def are_logs(job: JobInput) -> bool:
    """Whether all campaigns of a job are logs of torques."""
    return bool(job.campaigns) and all(map(core_observations.is_log, job.campaigns.values()))


def fit_torques(job: JobInput, progress: Progress) -> JobOutput:
    """Fit logs with the effects of torques that the job asks for; campaigns that validate, or a third of the motions, judge."""
    held = job.validation if isinstance(job.validation, dict) else {}
    parts = renumber_poses_and_sessions(map(as_session, [*job.campaigns.values(), *held.values()]))
    rows = core_motion.join_logs(parts[: len(job.campaigns)])
    return search_torques(job, rows, parts[len(job.campaigns) :], progress, fitted=True)


def search_torques(
    job: JobInput, rows: Observations, apart: Sequence[Observations], progress: Progress, fitted: bool = False
) -> JobOutput:
    """Search logs of joint torques, or fit them; it makes no version, for it says nothing of where the tool is.

    Raises:
        OptionError: an effect that torques do not show.

    """
    held = [int(session) for one in apart if one.session is not None for session in np.unique(one.session)]
    wanted, others = core_motion.split_effects(_effects(job))
    if others:
        raise OptionError(
            f"{_name(others[0])} is not an effect of torques, and these rows are a log of them: "
            "`kilter server effects` lists those that are.",
            option="effects",
        )
    options = core_motion.MotionOptions(job.options.seed, wanted if wanted or fitted else None, fitted)
    report = core_motion.find_missing_torque(
        job.robot, Observations.concatenate([rows, *apart]), options, progress, held
    )
    found = core_motion.to_document(report)
    starts = np.cumsum([0, *(len(one) for one in job.campaigns.values())])[:-1]
    assert rows.session is not None
    names = {int(rows.session[k]): job.names.get(c, c) for c, k in zip(job.campaigns, starts, strict=True)}
    found["warnings"] += _unused_options(job)
    for effect in found["effects"]:
        effect["campaign"] = names.get(effect.pop("session"))
    return JobOutput(to_json_types({**found, "start": job.version_id, "version_id": None}))


def refuse_effects_of_torques(asked: Sequence[Any]) -> None:
    """Refuse effects that poses do not show.

    Raises:
        OptionError: an effect of torques.

    """
    for name in core_motion.split_effects(asked)[0]:
        raise OptionError(
            f"{name} is an effect of torques, and these rows are poses: name a log with t_s and tau1_nm ....",
            option="effects",
        )


def _unused_options(job: JobInput) -> list[dict[str, Any]]:
    """Say which options were given that say nothing of torques."""
    fields = type(job.options).model_fields.items()
    asked = {name: getattr(job.options, name) for name, _ in fields}
    unused = [n for n, field in fields if n not in READ and asked[n] != field.get_default(call_default_factory=True)]
    if not unused:
        return []
    message = (
        f"{', '.join(unused)} did nothing: logs of torques are told by effects, seed and start alone. Leave them out."
    )
    return [{"code": "options_unused", "message": message}]


def _effects(job: JobInput) -> list[Any]:
    return [one if isinstance(one, str) else one.model_dump(mode="json") for one in job.options.effects]


def _name(effect: Any) -> str:
    return str(effect if isinstance(effect, str) else effect["id"])


DIGITS = 4  # of a degree or a millimetre


@dataclass(frozen=True)
class Pose:
    """A pose to measure: joints (n,), rad or m, and the conditions it asks for."""

    q: Floats
    kind: str = "new"
    change: str | None = None
    payload_kg: float | None = None
    payload_com: tuple[float, float, float] | None = None
    direction: tuple[int, ...] | None = None
    information_factor: float | None = None
    pose_id: int | None = None
    session: int | None = None


def poses_from_rows(
    rows: Observations, kind: str = "new", change: str | None = None, factors: Sequence[float] = ()
) -> list[Pose]:
    """Rows of a plan as poses; ``factors`` say how much more is known after each."""
    return [
        Pose(
            q=rows.q[k],
            kind=kind,
            change=change,
            payload_kg=None if rows.payload_kg is None else float(rows.payload_kg[k]),
            payload_com=_centre(rows, k),
            direction=None if rows.direction is None else tuple(int(s) for s in rows.direction[k]),
            information_factor=round(float(factors[k]), 3) if len(factors) else None,
        )
        for k in range(len(rows))
    ]


def _centre(rows: Observations, k: int) -> tuple[float, float, float] | None:
    """Where the load of a row hangs; None where nobody said, and where no load is asked for."""
    if rows.payload_kg is None or rows.payload_com is None:
        return None
    x, y, z = rows.payload_com[k].tolist()
    return x, y, z


def poses_document(robot: Robot, poses: Sequence[Pose]) -> dict[str, Any]:
    """Poses within the robot's limits, as rows and as the text of a CSV file of contract columns."""
    rows = [_row(robot, pose) for pose in poses]
    return {"count": len(rows), "poses": rows, "csv": _csv(robot, rows)}


def _row(robot: Robot, pose: Pose) -> dict[str, Any]:
    low, high = robot.limits.T
    q = np.clip(pose.q, low, high)
    row: dict[str, Any] = {
        name: round(float(v * k), DIGITS)
        for name, k, v in zip(joint_columns(robot), joint_scale(robot), q, strict=True)
    }
    row |= {
        "kind": pose.kind,
        "change": pose.change,
        "payload_kg": pose.payload_kg,
        "direction": None if pose.direction is None else list(pose.direction),
        "information_factor": pose.information_factor,
    }
    if pose.payload_com is not None:
        row["payload_com_mm"] = [round(to_mm(value), DIGITS) for value in pose.payload_com]
    numbers = {"pose_id": pose.pose_id, "session": pose.session}
    return row | {name: number for name, number in numbers.items() if number is not None}


def joint_columns(robot: Robot) -> list[str]:
    """Return the names of a measurement's joint columns."""
    return [f"q{j}_{unit}" for j, unit in enumerate(joint_units(robot), 1)]


def _csv(robot: Robot, rows: Sequence[dict[str, Any]]) -> str:
    names = joint_columns(robot)
    columns: dict[str, list[Any]] = {name: [row[name] for row in rows] for name in names}
    if all(row["payload_kg"] is not None for row in rows):
        columns["payload_kg"] = [row["payload_kg"] for row in rows]
    if rows and all("payload_com_mm" in row for row in rows):
        columns |= {
            f"payload_com_{axis}_mm": [row["payload_com_mm"][k] for row in rows] for k, axis in enumerate("xyz")
        }
    if all(row["direction"] is not None for row in rows):
        columns |= {f"dir{j}": [row["direction"][j - 1] for row in rows] for j in range(1, len(names) + 1)}
    for name in ("pose_id", "session"):
        if all(name in row for row in rows):
            columns[name] = [row[name] for row in rows]
    lines = [
        ",".join(columns),
        *(",".join(f"{cell:.10g}" for cell in cells) for cells in zip(*columns.values(), strict=True)),
    ]
    return "\n".join(lines) + "\n"
