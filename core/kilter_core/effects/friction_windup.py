"""Wind-up of the drive by its own friction, held after the joint has stopped."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import REVERSAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

WIDEST = math.radians(0.5)
PRIOR_SIGMA = (
    "Standard deviation of the prior of the wind-up, rad (of a prismatic joint per 0.1 m): that of a hobby servo is its "
    "friction over its stiffness, some 0.005."
)


@dataclass(frozen=True)
class FrictionWindup(Effect):
    """dq = k s with s the direction of the joint's last motion and |k| = friction torque over stiffness.

    In position data this is the same as ``backlash`` with b = 2k: only torque can distinguish them.
    """

    id = "friction_windup"
    summary = "wind-up of the drive by friction, on the side of the last motion"
    physical = REVERSAL
    separated_by = (Separator.FRICTION,)
    source = "Seyfferth, Maghzal and Angeles 1995; Tuttle 1992, harmonic drives"
    needs = frozenset({"direction"})
    sided = True
    aliases = ("backlash", "backlash_load")
    remedy = (
        "a log of joint torques (masses_from), and poses at two loads: in positions alone it is the same as backlash"
    )

    prior_sigma_rad: float = option(math.radians(0.05), PRIOR_SIGMA, low=1e-6, high=0.035)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Wind-up k per joint, rad."""
        wide = max(WIDEST, 3.0 * self.prior_sigma_rad)
        return self.per_joint(robot, "windup", "rad", self.prior_sigma_rad, -wide, wide, "wind-up k")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        return self.joint_angle(batch, values, self.column(batch, "direction"))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the windups: each is half a reversal."""
        form.add("reversal", self.acting(len(form.joints)), 2.0 * values)
        return True
