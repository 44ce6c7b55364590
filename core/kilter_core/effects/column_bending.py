"""A column or base mount that bends with temperature: sun or a warm machine on one side of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_temperature import LawOfTemperature
from kilter_core.effects.physical import THERMAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ColumnBending(LawOfTemperature):
    """The base frame rotates by (kx, ky, 0) (T − T0) about its origin; ``reference_c`` is T0, at which the geometry holds."""

    id = "column_bending"
    summary = "column under the arm bends with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "ISO 230-3, environmental temperature variation: a gradient across a column bends it"
    stage = "base"
    aliases = ("thermal_drift", "zero_thermal", "thermal_growth", "drift", "settling")
    remedy = "measure a reflector on the base cold and warm, or revisit the same poses all around cold and warm"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates kx, ky about x and y of the base frame, rad/K."""
        return tuple(
            Parameter(f"column_bending_{k}", "rad/K", 0.0, 1e-5, -2e-4, 2e-4, f"rotation of the base about its {k}")
            for k in "xy"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives."""
        warmer = self.warmer(batch)
        turns = np.zeros((2, len(batch), 6))
        turns[0, :, 3] = turns[1, :, 4] = warmer
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(turns)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the tilt of the base at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        form.base_tilt[:2] += values * warmer
        return True
