"""Zero of one joint that moves with time: an encoder that warms up, a belt or a clamp that creeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_time import LawOfTime
from kilter_core.effects.physical import JOINT_ZERO, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ZeroDrift(LawOfTime):
    """dq = r (t − t0) per joint.

    ``t0_s`` is when the zero is that of the geometry; without it the first row's time, once rows are known. At a joint
    whose axis is fixed in the base, as the first one's does, it is one of the motions of ``drift``.
    """

    id = "zero_drift"
    summary = "zero of a joint moves with time"
    physical = JOINT_ZERO
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "Yin et al. 2014, joint by joint warm-up: which parameters move; ISO 9283, drift of pose characteristics"
    aliases = ("drift", "zero_thermal", "settling")
    remedy = "revisit poses during the campaign that move this joint's zero differently from the base, in random order"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate r per joint, rad/s."""
        return self.per_joint(robot, "zero_drift", "rad/s", 1e-7, -1e-5, 1e-5, "rate of the joint's zero")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by the rate."""
        return self.joint_angle(batch, values, np.broadcast_to(self.elapsed_time(batch)[:, None], batch.q.shape))
