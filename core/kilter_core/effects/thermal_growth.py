"""Growth of all links with temperature."""

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
class ThermalGrowth(LawOfTemperature):
    """Every link, and the column up to the first joint, grows by α (T − T0) of its length; the tool does not.

    ``reference_c`` is T0, at which the geometry holds. Any T0 will do as long as all campaigns use the same one.
    """

    id = "thermal_growth"
    summary = "links grow with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "Yin et al. 2014, warm-up of robot joints; linear expansion of steel and aluminium"
    signs = "positive"
    aliases = ("drift", "measurement_scale")
    remedy = "revisit the same poses cold and warm, with a temperature in every row"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coefficient of expansion α, 1/K; steel has 12e-6, aluminium 23e-6.

        The range is wider than that of metals: the thermometer is seldom where the links are warmest.
        """
        return (Parameter("expansion", "1/K", 0.0, 2e-5, 0.0, 1e-4, "coefficient of expansion"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, of the base frame along the column; and the derivative."""
        warmer = self.warmer(batch)
        grown = np.zeros((len(batch.link_vectors), len(batch), 6))
        grown[:, :, :3] = batch.link_vectors[:, None, :] * warmer[:, None]
        places = [*range(len(grown) - 1), BASE]
        return linear(batch, values, [Derivative(0, place, xi=xi) for place, xi in zip(places, grown, strict=True)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the growth of every link at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        grown = float(values[0]) * warmer * form.robot.chain.link_vectors
        for j, translation in enumerate(grown[:-1]):
            form.twist(j, translation)
        form.base_shift += grown[-1]
        return True
