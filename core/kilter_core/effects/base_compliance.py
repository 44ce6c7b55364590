"""Tilt of the base or its mount under the moment of the whole arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import BASE_TILT, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """The base frame rotates by (cx mx, cy my, 0) about its origin, m the load moment on the base."""

    id = "base_compliance"
    summary = "tilt of base or its mount under the moment of the arm"
    physical = BASE_TILT
    separated_by = (Separator.LOADS,)
    source = "base and mount compliance"
    needs = frozenset({"moments"})
    reads = (("base_wrench", (3, 4)),)
    stage = "base"
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "link_bending", "clearance_tilt")
    remedy = "measure a reflector on the base while the arm moves, or repeat poses with a second payload"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliances cx, cy about x and y of the base frame, rad/(N m)."""
        return tuple(
            Parameter(f"base_compliance_{k}", "rad/(N m)", 0.0, 1e-5, 0.0, 1e-3, f"tilt of the base about its {k}")
            for k in "xy"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives."""
        tilts = np.zeros((2, len(batch), 6))
        tilts[0, :, 3] = batch.base_wrench[:, 3]
        tilts[1, :, 4] = batch.base_wrench[:, 4]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(tilts)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the compliances of the base mount."""
        x, y = form.base_compliance or (0.0, 0.0)
        form.base_compliance = (x + float(values[0]), y + float(values[1]))
        return True
