"""Clocks of controller and instrument that differ: positions of a moving arm belong to other joint readings."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Derivative, Effect, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import DELAY
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class TimeOffset(Effect):
    """dq = q̇ dt for all joints: the position was taken dt after the joint readings of its row."""

    id = "time_offset"
    summary = "delay between the joint readings and the measured positions"
    physical = DELAY
    source = "time offset of controller and tracker; first order in dt"
    needs = frozenset({"qd"})
    stage = "measurement"
    aliases = ("tracking_lag", "drift")
    remedy = "record moving arms at different speed profiles: at rest, or at one speed, it cannot be seen"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Delay dt, s."""
        return (
            Parameter("time_offset", "s", 0.0, 0.02, -0.5, 0.5, "delay of the positions behind the joint readings"),
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint corrections and their derivative by dt."""
        speed = self.column(batch, "qd")
        return linear(batch, values, [Derivative(0, j, dq=speed[:, j]) for j in range(batch.q.shape[1])])
