"""Slow motion of the base in the frame of the instrument, or of the instrument itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import STATION, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Drift(Effect):
    """The base frame moves at constant rates: a twist of six rates times t − t0, in its own axes.

    ``t0_s`` is when the base is where the geometry says; without it the first row's time, once rows are known.
    """

    id = "drift"
    summary = "slow motion of the base or of the instrument with time"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 9283, drift of pose characteristics; Barfoot, State Estimation for Robotics, 7.1"
    needs = frozenset({"t"})
    stage = "base"
    aliases = ("thermal_growth", "session_shift")
    remedy = "revisit a reference pose during the campaign, and visit the others in random order"
    at_joints = False

    t0_s: float | None = option(
        None, "When the base was where the geometry says, s on the clock of the rows; null: the earliest row."
    )

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Start the drift at the earliest row."""
        if self.t0_s is not None or rows is None or rows.t is None or not len(rows):
            return self
        return replace(self, t0_s=float(np.min(rows.t)))

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
        t = np.asarray(self.column(batch, "t"), dtype=np.float64)
        if self.t0_s is None:
            raise OptionError("drift needs t0_s: give the time in s at which the geometry holds.", effect=self.id)
        moved = np.eye(6)[:, None, :] * (t - self.t0_s)[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
