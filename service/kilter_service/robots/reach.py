"""How far the tool of an arm can be from its base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from kilter_core.arm import Robot


def longest_reach(robot: Robot) -> float:
    """Return the sum of all lengths and strokes of the arm and its tool (m): no point of the workspace is farther out."""
    lengths = sum(abs(e.value) for e in robot.chain.elements if not e.axis.rotates)
    strokes = [max(abs(j.lower), abs(j.upper)) for j in robot.joints if j.kind == "prismatic"]
    return float(lengths + sum(strokes) + np.linalg.norm(robot.T_tool[:3, 3]))
