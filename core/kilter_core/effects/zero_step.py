"""Zero of one joint that jumped once: a knock, a coupling that slipped, an encoder that lost counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_ZERO
from kilter_core.effects.step import Step
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ZeroStep(Step):
    """The zero of a joint jumped by d between two rows: dq was less by d before it."""

    id = "zero_step"
    summary = "zero of a joint jumped once, between two rows"
    physical = JOINT_ZERO
    stage = "joint"
    aliases = ("zero_drift", "zero_thermal", "base_step")
    remedy = "measure again without what came before it, and find out what knocked or slipped"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jump d per joint, rad."""
        return self.per_joint(robot, "zero_step", "rad", 5e-3, -0.2, 0.2, "jump of the joint's zero")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by the jump."""
        before = -batch.before_event_indicator(self.at_s, self.at_row)
        return self.joint_angle(batch, values, np.broadcast_to(before[:, None], batch.q.shape))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True
