"""Backlash taken up by the load about the joint axis (thesis eq. 5.19, first term)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core.effects.base import Batch, Effect, Floats, Local, soft_sign
from core.parameters import Parameter
from core.robot import Robot

NO_MOMENT_NM = 1e-9  # below this the sign would be that of rounding noise


@dataclass(frozen=True)
class BacklashLoad(Effect):
    """dq = b sign(ηz): the load rests the gear on one flank. ``softening_nm`` > 0 makes the sign a tanh."""

    id = "backlash_load"
    summary = "backlash on the side of the axial load moment"
    source = "thesis eq. 5.19"
    needs = frozenset({"moments"})
    signs = "positive"
    aliases = ("axial_compliance", "eccentricity", "backlash")
    remedy = "measure poses where the load on the joint has both signs, or the same poses with another payload"

    softening_nm: float = 0.0

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Backlash b per joint, rad."""
        return self.per_joint(robot, "backlash_load", "rad", math.radians(0.1), 0.0, math.radians(1.0), "backlash b")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b."""
        about = batch.axial
        side = np.where(np.abs(about) > NO_MOMENT_NM, soft_sign(about, self.softening_nm), 0.0)
        return self.joint_angle(batch, values, side)
