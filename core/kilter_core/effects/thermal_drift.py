"""Motion of the base or of the instrument with temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import THERMAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """The base frame moves with temperature: a twist of six rates times T − T0, in its own axes.

    ``reference_c`` is T0, at which the geometry holds. Whatever rotates a vertical first joint with temperature does the
    same to every measurement, and so does a bending column: where one of them fits, this belongs to its class.
    """

    id = "thermal_drift"
    summary = "motion of the base or of the instrument with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "ISO 230-3, environmental temperature variation"
    needs = frozenset({"temperature_c"})
    stage = "base"
    aliases = ("zero_thermal", "column_bending", "thermal_growth", "drift")
    remedy = "measure a reflector on the base cold and warm beside the poses"
    at_joints = False

    reference_c: float = option(20.0, "Temperature T0 at which the geometry holds, degrees Celsius.", above=-273.15)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates along x, y, z, m/K, then about them, rad/K."""
        return tuple(
            Parameter(f"thermal_drift_{k}", f"{'rad' if 'r' in k else 'm'}/K", 0.0, 1e-5, -2e-4, 2e-4,
                      f"rate of the base's {k}")
            for k in ("x", "y", "z", "rx", "ry", "rz")
        )  # fmt: skip

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the rates."""
        warmer = np.asarray(self.column(batch, "temperature_c"), dtype=np.float64) - self.reference_c
        moved = np.eye(6)[:, None, :] * warmer[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
