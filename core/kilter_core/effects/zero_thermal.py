"""Zero of one joint that moves with temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_temperature import LawOfTemperature
from kilter_core.effects.physical import JOINT_ZERO, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ZeroThermal(LawOfTemperature):
    """dq = k (T − T0) per joint; ``reference_c`` is T0, at which the geometry holds."""

    id = "zero_thermal"
    summary = "zero of a joint moves with temperature"
    physical = JOINT_ZERO
    separated_by = (Separator.TEMPERATURE,)
    source = "Yin et al. 2014, warm-up of robot joints: the zeros move first"
    aliases = ("thermal_drift", "zero_drift", "column_bending", "thermal_growth", "link_growth")
    remedy = "revisit the same poses cold and warm, with a temperature in every row"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate k per joint, rad/K."""
        return self.per_joint(robot, "zero_thermal", "rad/K", 2e-5, -5e-4, 5e-4, "zero of the joint by temperature")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        warmer = self.warmer(batch)
        return self.joint_angle(batch, values, np.broadcast_to(warmer[:, None], batch.q.shape))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the shift of each zero at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        form.add("offset", self.acting(len(form.joints)), values * warmer)
        return True
