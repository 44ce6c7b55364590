"""Servo lag: a joint runs behind its setpoint in proportion to its speed."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import DELAY
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class TrackingLag(Effect):
    """dq = −τ q̇ per joint, τ >= 0: the joint is where its setpoint was τ ago. For rows whose q are setpoints."""

    id = "tracking_lag"
    summary = "servo lag of a joint behind its setpoint"
    physical = DELAY
    source = "Slamani, Nubiola and Bonev 2012, contouring errors against speed"
    needs = frozenset({"qd"})
    signs = "positive"
    aliases = ("time_offset",)
    remedy = "record moving arms and read back the actual joint angles: equal lags of all joints are a time offset"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Lag τ per joint, s."""
        return self.per_joint(robot, "lag", "s", 0.02, 0.0, 0.5, "lag behind the setpoint")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by τ."""
        return self.joint_angle(batch, values, -self.column(batch, "qd"))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the lag of each joint."""
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.LAG, value)
        return True
