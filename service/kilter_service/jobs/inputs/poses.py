"""Planned poses as a document and as a file: contract columns, to be driven and then to be filled with measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.types import Floats
from kilter_service.ground.wire import joint_scale, joint_units, to_mm

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.observations import Observations


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
