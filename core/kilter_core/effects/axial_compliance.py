"""Twist of a joint about its own axis in proportion to the load moment (thesis eq. 4.15, 5.19, second term)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TWIST, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SOFTEST = 5.0  # times the compliance of a stated stiffness, which is a rough one


@dataclass(frozen=True)
class AxialCompliance(Effect):
    """dq = c ηz with c = 1/k >= 0; static or dynamic load, whichever the rows carry."""

    id = "axial_compliance"
    summary = "joint compliance about the axis, proportional to the load moment"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 4.15, 5.19"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("link_bending", "radial_compliance", "gravity_spring", "eccentricity")
    remedy = "repeat old poses with a second payload: geometry cancels, the load does not"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance c per joint, rad/(N m) (m/N for a prismatic joint); of the size of a stiffness that the robot states."""
        made = self.per_joint(robot, "compliance", "rad/(N m)", 1e-4, 0.0, 1e-2, "axial compliance c = 1/k")
        stated = (robot.joints[j].drive_stiffness for j in self.acting(robot.n_joints))
        return tuple(one if k is None else _about(one, 1.0 / k) for one, k in zip(made, stated, strict=True))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by c."""
        return self.joint_angle(batch, values, batch.axial)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("compliance", self.acting(len(form.joints)), values)
        return True


def _about(parameter: Parameter, compliance: float) -> Parameter:
    """The parameter expected to be of this size, where that is more than is usual."""
    usual = max(parameter.prior_sigma, compliance)
    return replace(parameter, prior_sigma=usual, upper=max(parameter.upper, SOFTEST * compliance))
