"""Where the SO-101 has its tool, nominal and with errors, by forward kinematics that share nothing with Kilter."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PRESET = Path(__file__).parents[3] / "core/kilter_core/arm/presets/so101.json"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


def elements() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(PRESET.read_text())["elements"]
    return found


def move(axis: str, amount: float) -> Floats:
    T = np.eye(4)
    k = "xyz".index(axis[1])
    if axis[0] == "T":
        T[k, 3] = amount
        return T
    c, s = np.cos(amount), np.sin(amount)
    i, j = (k + 1) % 3, (k + 2) % 3
    T[i, i], T[j, j], T[i, j], T[j, i] = c, c, -s, s
    return T


def tool(q_deg: Floats, errors: Mapping[str, float] | None = None) -> Floats:
    """Pose (4, 4) of the tool, mm, at real joint angles (5,) degrees; ``errors`` by name of an element, mm or degrees."""
    T = np.eye(4)
    for one in elements():
        value = q_deg[JOINTS.index(one["joint"])] if "joint" in one else one["value"]
        value += (errors or {}).get(one.get("name", ""), 0.0)
        T = T @ move(one["axis"], np.radians(value) if one["axis"][0] == "R" else value)
    return T


def tool_mm(q_deg: Floats, errors: Mapping[str, float] | None = None) -> Floats:
    """Tool point (3,) mm, as ``tool``."""
    found: Floats = tool(q_deg, errors)[:3, 3]
    return found
