"""Hardening of a gear: it gets stiffer the more it is wound, as strain wave gears do."""

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
class Hardening(Effect):
    """dq = −h ηz |ηz| with h >= 0, beside the c ηz of ``axial_compliance``: what large loads twist less than small ones.

    It has no meaning alone, and none beyond the load at which c ηz − h ηz |ηz| has its extremum.
    """

    id = "hardening"
    summary = "gear gets stiffer under load, beside its compliance"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "Harmonic Drive: stiffness K1 < K2 < K3 by load; the curve's first two terms"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("axial_compliance", "backlash_load", "direction_compliance")
    remedy = "repeat poses with three payloads or more, one of them none"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Hardening h per joint, rad/(N m)² (m/N² for a prismatic joint)."""
        return self.per_joint(robot, "hardening", "rad/(N m)2", 1e-5, 0.0, 1e-3, "hardening of the compliance")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by h."""
        return self.joint_angle(batch, values, -batch.axial * np.abs(batch.axial))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("hardening", self.acting(len(form.joints)), values)
        return True
