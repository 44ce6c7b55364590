"""Tilt of a joint in its bearings in proportion to the transverse load moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_TILT, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class RadialCompliance(Effect):
    """The joint tilts by c (ηx, ηy) about x and y of its frame, c >= 0: a bearing equally stiff in all directions."""

    id = "radial_compliance"
    summary = "tilt of the bearing in proportion to the transverse load moment"
    physical = JOINT_TILT
    separated_by = (Separator.LOADS,)
    source = "Li, Gao and Liu 2020, axial and radial deformation of joints"
    needs = frozenset({"moments"})
    reads = (("wrench", (3, 4)),)
    signs = "positive"
    aliases = ("axial_compliance", "link_bending", "base_compliance", "clearance_tilt")
    remedy = "load the arm from the side or with a second payload, at many azimuths of the joint"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance c per joint, rad/(N m)."""
        text = "radial compliance c of the bearing"
        return self.per_joint(robot, "radial_compliance", "rad/(N m)", 1e-4, 0.0, 1e-2, text, rotates=True)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist (0, 0, 0, c ηx, c ηy, 0) per joint and its derivative by c."""
        across = np.zeros_like(batch.wrench)
        across[:, :, 3:5] = batch.moment[:, :, :2]
        acting = enumerate(self.acting(batch.q.shape[1]))
        return linear(batch, values, [Derivative(k, j, xi=across[:, j]) for k, j in acting])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("radial_compliance", self.acting(len(form.joints)), values)
        return True
