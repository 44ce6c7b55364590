"""Backlash seen from the direction of approach: the joint lags behind its motor by half the backlash."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import REVERSAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Backlash(Effect):
    """dq = b s / 2 with s in {-1, 0, +1} the direction of the joint's last motion.

    A joint that lags behind its motor has b < 0 in this convention; the sign is left to the data.
    """

    id = "backlash"
    summary = "reversal error with the direction of the joint's last motion"
    physical = REVERSAL
    separated_by = (Separator.FRICTION,)
    source = "gap-finder library; Slamani, Nubiola and Bonev 2012"
    needs = frozenset({"direction"})
    sided = True
    aliases = ("friction_windup", "backlash_load")
    remedy = "approach the same poses from both sides with every joint: one-sided, it is an encoder offset"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Reversal width b per joint, rad."""
        wide = math.radians(1.0)
        return self.per_joint(robot, "backlash", "rad", math.radians(0.1), -wide, wide, "reversal width b")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b.

        Raises:
            ObservationError: the rows have no direction.

        """
        return self.joint_angle(batch, values, self.column(batch, "direction") / 2.0)

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Half the width either way, in rows that a joint came to from a side that nobody knows."""
        if batch.direction is None:
            return ()
        acting = ((k, j, batch.direction[:, j] == 0.0) for k, j in enumerate(self.acting(batch.q.shape[1])))
        return tuple(
            Derivative(k, j, dq=0.5 * values[k] * unknown) for k, j, unknown in acting if values[k] and unknown.any()
        )

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("reversal", self.acting(len(form.joints)), values)
        return True
