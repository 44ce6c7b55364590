"""Compliance that depends on the side a joint was approached from: a gear winds up stiffer than it unwinds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TWIST, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class DirectionCompliance(Effect):
    """dq = h s ηz with s the direction of the joint's last motion: c + h after moving up, c − h after moving down."""

    id = "direction_compliance"
    summary = "compliance differs with the direction of approach"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "hysteresis of gears, loading and unloading branch: Seyfferth et al. 1995; Tuttle 1992"
    needs = frozenset({"moments", "direction"})
    sided = True
    reads = (("axial", (0,)),)
    aliases = ("axial_compliance", "backlash", "backlash_load")
    remedy = "approach the same poses from both sides, with two payloads"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Difference h per joint, rad/(N m) (m/N for a prismatic joint)."""
        text = "compliance after moving up less the mean"
        return self.per_joint(robot, "direction_compliance", "rad/(N m)", 3e-5, -5e-3, 5e-3, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by h."""
        side = np.asarray(self.column(batch, "direction"), dtype=np.float64)
        return self.joint_angle(batch, values, side * batch.sided_axial)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("compliance_by_direction", self.acting(len(form.joints)), values)
        return True
