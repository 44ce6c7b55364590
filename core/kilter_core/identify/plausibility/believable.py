"""Whether a reading of the rows can be true at all, however well it fits: nine free numbers fit some readings by chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.identify.plausibility.mix_ups import MixUp
from kilter_core.identify.plausibility.placed import Sample

LONGEST_TOOL = 2.0  # reaches; a small arm may carry a long rod,
LEAST_TOOL_M = 1.0
TOLD = 0.2  # share of the length that tells a unit: more must be missing before, less may be missing after
BEYOND = 0.1  # share of its range by which a joint may be outside its limits
TURNS = 4.0 * np.pi  # where a joint has no limits
WITHIN = 0.95  # share of the rows


def reach(robot: Robot) -> float:
    """How far (m) the tool point can be from the base: all lengths of the arm in a row."""
    lengths = sum(abs(e.value) for e in robot.chain.elements if not e.axis.rotates)
    ends = [abs(end) for j in robot.joints if j.kind == "prismatic" for end in (j.lower, j.upper)]
    strokes = sum(max(pair) for pair in zip(ends[::2], ends[1::2], strict=True) if np.isfinite(pair).all())
    return float(lengths + strokes + np.linalg.norm(robot.T_tool[:3, 3]))


def believable(sample: Sample, mixed: Sequence[MixUp], read: Sample) -> bool:
    """Whether the rows of ``sample`` can be what ``read`` has after these mix-ups."""
    robot = sample.begin.robot
    if np.linalg.norm(read.fitted_placement.tool) > max(LONGEST_TOOL * reach(robot), LEAST_TOOL_M):
        return False
    units = [m.factor for m in mixed if m.of_units and m.factor is not None]
    if units and not _within_limits(robot, read):
        return False
    # Readings that a larger unit makes smaller are beyond the limits as they are: else it only makes a joint stand still.
    if any(np.min(factor) < 1.0 for factor in units) and _within_limits(robot, sample):
        return False
    factor = float(np.prod([m.length for m in mixed]))
    return factor == 1.0 or _tells(sample, read, factor)


def _tells(sample: Sample, read: Sample, factor: float) -> bool:
    """Whether another unit of the points would be seen as it is seen here.

    A tool of any length takes up the unit of a point that moves on a sphere; only what the chain's own lengths move can
    tell, and what is missing as the rows are must be of the size that the other unit makes of it.
    """
    missing = TOLD * read.lengths * abs(1.0 / factor - 1.0)
    return sample.fitted_placement.size > missing and read.fitted_placement.size < TOLD * read.lengths


def _within_limits(robot: Robot, read: Sample) -> bool:
    """Whether the joints can have been where a reading in another unit puts them."""
    low, high = robot.limits.T
    slack = np.where(np.isfinite(high - low), BEYOND * (high - low), 0.0)
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low - slack, -TURNS), np.where(bounded, high + slack, TURNS)
    revolute = np.array([j.kind == "revolute" for j in robot.joints])
    inside = ((read.q >= low) & (read.q <= high)) | ~(revolute | bounded)
    return bool(np.mean(inside.all(axis=1)) >= WITHIN)
