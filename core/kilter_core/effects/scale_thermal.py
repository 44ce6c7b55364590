"""Scale of the instrument that follows the temperature: warm air, or a warm scale bar."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_temperature import LawOfTemperature
from kilter_core.effects.physical import THERMAL, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ScaleThermal(LawOfTemperature):
    """The measured position is 1 + k (T − T0) times the real one, seen from the origin of the measurements.

    A growth of all links by k beside a drift of the base by k times its position does exactly the same but at the tool.
    """

    id = "scale_thermal"
    summary = "scale of the instrument changes with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE, Separator.SENSOR)
    source = "Ciddor 1996, refractive index of air: 1e-6 a kelvin; expansion of a scale bar, 23e-6 of aluminium"
    stage = "measurement"
    aliases = ("thermal_drift", "thermal_growth", "link_growth")
    remedy = "measure a reflector on the base, or an artefact of known length, cold and warm beside the poses"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate k of the scale, 1/K."""
        return (Parameter("scale_thermal", "1/K", 0.0, 1e-5, -1e-4, 1e-4, "rate of the instrument's scale"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Stretch and its derivative by k."""
        return linear(batch, values, [Derivative(0, scale=self.warmer(batch))])
