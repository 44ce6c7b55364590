"""Motion of the base or of the instrument with temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_temperature import LawOfTemperature
from kilter_core.effects.physical import THERMAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ThermalDrift(LawOfTemperature):
    """The base frame moves with temperature: a twist of six rates times T − T0, in its own axes.

    ``reference_c`` is T0, at which the geometry holds. Whatever rotates a vertical first joint with temperature does the
    same to every measurement, and so does a bending column: where one of them fits, this belongs to its class.
    """

    id = "thermal_drift"
    summary = "motion of the base or of the instrument with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE, Separator.SENSOR)
    source = "ISO 230-3, environmental temperature variation"
    stage = "base"
    aliases = ("zero_thermal", "column_bending", "thermal_growth", "scale_thermal", "drift")
    remedy = "measure a reflector on the base cold and warm beside the poses"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates along x, y, z, m/K, then about them, rad/K."""
        return tuple(
            Parameter(
                f"thermal_drift_{k}",
                f"{'rad' if 'r' in k else 'm'}/K",
                0.0,
                1e-5,
                -2e-4,
                2e-4,
                f"rate of the base's {k}",
            )
            for k in ("x", "y", "z", "rx", "ry", "rz")
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the rates."""
        warmer = self.warmer(batch)
        moved = np.eye(6)[:, None, :] * warmer[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
