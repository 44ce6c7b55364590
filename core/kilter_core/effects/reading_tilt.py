"""A joint reading that changes when the joint tilts: an encoder whose head and disc tilt towards each other."""

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
class ReadingTilt(Effect):
    """dq = kx ηx + ky ηy: the joint tilts in proportion to the load across it, and its encoder reads part of that as rotation.

    The thesis leaves open how tilting changes the readings; to first order a head at a fixed place of the joint sees
    one component of the tilt, whose direction kx and ky give.
    """

    id = "reading_tilt"
    summary = "encoder reads the tilt of its own joint as rotation"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = (
        "thesis, future work: encoder readings affected by the tilt of the joint; first order in the load across it"
    )
    needs = frozenset({"moments"})
    reads = (("wrench", (3, 4)),)
    in_part = (
        True  # load about one direction across a last joint is often next to nothing: the other is seen all the same
    )
    aliases = ("axial_compliance", "radial_compliance", "clearance_tilt", "eccentricity")
    remedy = "put a second encoder head opposite the first: the mean of both does not see the tilt"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Sensitivities kx, then ky per joint, rad/(N m) (m/N m for a prismatic joint)."""
        text = "reading by the load moment about "
        return tuple(
            p
            for k in "xy"
            for p in self.per_joint(robot, f"reading_tilt_{k}", "rad/(N m)", 3e-5, -5e-3, 5e-3, text + k)
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by kx and ky."""
        return self.joint_angle(batch, values, batch.moment[:, :, 0], batch.moment[:, :, 1])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add what a load across the axis adds to the joint itself, linear in that load."""
        joints = self.acting(len(form.joints))
        for place, j in enumerate(joints):
            rotations = np.zeros((6, 6))
            rotations[5 if form.robot.joints[j].kind == "revolute" else 2, 3:5] = values[place :: len(joints)]
            form.bend(j, rotations, np.zeros((6, 6)), np.zeros(3), of_axis=True)
        return True
