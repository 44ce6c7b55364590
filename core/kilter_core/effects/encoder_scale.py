"""Scale of a joint reading: a gear ratio or an encoder pitch that is not what the controller believes."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Batch, Effect, Local
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class EncoderScale(Effect):
    """dq = k q: the joint moves (1 + k) times what it reads."""

    id = "encoder_scale"
    summary = "scale error of a joint reading: gear ratio or encoder pitch"
    source = "Whitney, Lozinski and Rourke 1986"
    aliases = ("eccentricity", "gravity_spring", "second_harmonic")
    remedy = "move the joint over its whole range, best over more than one turn"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Relative scale error k per joint."""
        return self.per_joint(robot, "encoder_scale", "1", 1e-3, -0.02, 0.02, "relative scale error k")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        return self.joint_angle(batch, values, batch.q)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a straight line for each joint."""
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.LINEAR, value)
        return True
