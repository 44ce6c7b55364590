"""Whether joint readings lag behind: reading less command follows the sign of the motion, and passes for a backlash."""

from __future__ import annotations

from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.parameters import degrees, mm
from kilter_core.types import Floats

EACH_SIDE = 4  # rows from each side that a joint needs
CERTAIN = 5.0  # standard errors by which the two sides must differ
LEAST = 2e-5  # rad or m between the two sides that is worth a word


def lag_warnings(robot: Robot, rows: Observations) -> list[dict[str, Any]]:
    """Say of which joints reading less command follows the direction of the motion, and by how much from side to side."""
    if rows.command is None:
        return []
    apart = rows.q - rows.command
    widths = np.array([_width(apart[:, j], side) for j, side in enumerate(_sides(rows).T)])
    found = [int(j) for j in np.flatnonzero(np.abs(widths) > LEAST)]
    if not found:
        return []
    shown = [
        f"{mm(abs(widths[j])):.3g} mm" if robot.joints[j].kind == "prismatic" else f"{degrees(abs(widths[j])):.3g} deg"
        for j in found
    ]  # fmt: skip
    said = ", ".join(f"joint {j + 1} by {size}" for j, size in zip(found, shown, strict=True))
    return [
        {
            "code": "readings_follow_motion", "joints": [j + 1 for j in found],
            "message": f"Reading less command differs between the two directions of motion: {said}. If the arm had not arrived "
            "when its joints were read, or the log is late, this comes out as a backlash of those joints: read them at rest, "
            "or upload the commands as q. If the arm stood still, its servos stop short and the readings are right.",
        }
    ]  # fmt: skip


def _sides(rows: Observations) -> Floats:
    """Direction (N, n) in which each joint moved last: as stated, else from the command of the row before."""
    if rows.direction is not None:
        return rows.direction
    assert rows.command is not None
    out = np.zeros_like(rows.q)
    order = read_clock(rows).order
    out[order[1:]] = np.sign(np.diff(rows.command[order], axis=0))
    return out


def _width(apart: Floats, side: Floats) -> float:
    """Difference between the means of the two sides; 0 where it is not certain."""
    there = np.isfinite(apart)
    up, down = apart[there & (side > 0)], apart[there & (side < 0)]
    if min(len(up), len(down)) < EACH_SIDE:
        return 0.0
    error = float(np.sqrt(np.var(up, ddof=1) / len(up) + np.var(down, ddof=1) / len(down)))
    width = float(np.mean(up) - np.mean(down))
    return width if abs(width) > CERTAIN * error else 0.0
