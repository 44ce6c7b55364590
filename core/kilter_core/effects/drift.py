"""Slow motion of the base in the frame of the instrument, or of the instrument itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_time import LawOfTime
from kilter_core.effects.physical import STATION, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Drift(LawOfTime):
    """The base frame moves at constant rates: a twist of six rates times t − t0, in its own axes.

    ``t0_s`` is when the base is where the geometry says; without it the first row's time, once rows are known.
    """

    id = "drift"
    summary = "slow motion of the base or of the instrument with time"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 9283, drift of pose characteristics; Barfoot, State Estimation for Robotics, 7.1"
    stage = "base"
    aliases = ("thermal_growth", "session_shift")
    remedy = "revisit a reference pose during the campaign, and visit the others in random order"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates along x, y, z, m/s, then about them, rad/s."""
        return tuple(
            Parameter(
                f"drift_{k}", f"{'rad' if 'r' in k else 'm'}/s", 0.0, 1e-6, -1e-4, 1e-4, f"rate of the base's {k}"
            )
            for k in ("x", "y", "z", "rx", "ry", "rz")
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the rates."""
        moved = np.eye(6)[:, None, :] * self.elapsed_time(batch)[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
