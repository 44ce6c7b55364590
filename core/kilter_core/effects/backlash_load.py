"""Backlash taken up by the load about the joint axis (thesis eq. 5.19, first term)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import SOFTENING, Derivative, Local, SignedByLoad, linear, option, soft_sign
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TWIST, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

PRIOR_SIGMA = (
    "Standard deviation of the prior of half the backlash, rad (of a prismatic joint per 0.1 m). Where the load keeps its sign "
    "the prior decides between backlash and the joint's zero: say 0.017 for hobby servos."
)
NO_MOMENT_NM = 1e-9  # below this the sign would be that of rounding noise


@dataclass(frozen=True)
class BacklashLoad(SignedByLoad):
    """dq = b sign(ηz): the load rests the gear on one flank. ``softening_nm`` > 0 makes the sign a tanh."""

    id = "backlash_load"
    summary = "backlash on the side of the axial load moment"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 5.19"
    needs = frozenset({"moments"})
    sided = about = True
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("axial_compliance", "eccentricity", "backlash")
    remedy = "measure poses where the load on the joint has both signs, or the same poses with another payload"

    softening_nm: float | tuple[float, ...] = option(0.0, SOFTENING, low=0.0)
    prior_sigma_rad: float = option(math.radians(0.1), PRIOR_SIGMA, low=1e-6, high=0.035)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Backlash b per joint, rad."""
        return self.per_joint(robot, "backlash_load", "rad", self.prior_sigma_rad, 0.0, math.radians(1.0), "backlash b")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b."""
        acting = enumerate(self.acting(batch.q.shape[1]))
        return linear(batch, values, [Derivative(k, j, dq=self._side(batch, k, j)) for k, j in acting])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the backlash, where no other effect has one by the load."""
        return form.add_side(self.acting(len(form.joints)), values, self.softening_nm)

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Scatter of a sign s around its expectation, √(1 − s²), times b."""
        acting = enumerate(self.acting(batch.q.shape[1]))
        left = ((k, j, 1.0 - self._side(batch, k, j) ** 2) for k, j in acting if values[k] != 0.0)
        return tuple(Derivative(k, j, dq=values[k] * np.sqrt(share)) for k, j, share in left)

    def _side(self, batch: Batch, place: int, joint: int) -> Floats:
        about = batch.sided_axial[:, joint]
        soft = soft_sign(about, self.sign_half_width(batch, place, joint))
        return np.where(np.abs(about) > NO_MOMENT_NM, soft, 0.0)
