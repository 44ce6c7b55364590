"""Wind-up of the drive by its own friction, held after the joint has stopped."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import REVERSAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class FrictionWindup(Effect):
    """dq = k s with s the direction of the joint's last motion and |k| = friction torque over stiffness.

    In position data this is the same as ``backlash`` with b = 2k: only torque can distinguish them.
    """

    id = "friction_windup"
    summary = "wind-up of the drive by friction, on the side of the last motion"
    physical = REVERSAL
    separated_by = (Separator.SIDES,)
    source = "Seyfferth, Maghzal and Angeles 1995; Tuttle 1992, harmonic drives"
    needs = frozenset({"direction"})
    sided = True
    aliases = ("backlash", "backlash_load")
    remedy = "the same as backlash in positions: compare motor currents, or release the joint by dither after the stop"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Wind-up k per joint, rad."""
        wide = math.radians(0.5)
        return self.per_joint(robot, "windup", "rad", math.radians(0.05), -wide, wide, "wind-up k")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        return self.joint_angle(batch, values, self.column(batch, "direction"))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the windups: each is half a reversal."""
        form.add("reversal", self.acting(len(form.joints)), 2.0 * values)
        return True
