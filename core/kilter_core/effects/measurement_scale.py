"""Scale of the instrument: all measured positions stretch about its origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Derivative, Effect, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import INSTRUMENT
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class MeasurementScale(Effect):
    """The measured position is (1 + s) times the real one, seen from the origin of the measurements."""

    id = "measurement_scale"
    summary = "scale error of the instrument"
    physical = INSTRUMENT
    source = "measurement scale: absorbed exactly by the link lengths"
    stage = "measurement"
    aliases = ("thermal_growth", "encoder_scale")
    remedy = "measure an artefact of known length: from robot data it cannot be distinguished from the link lengths"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Relative scale error s."""
        return (Parameter("measurement_scale", "1", 0.0, 1e-3, -0.02, 0.02, "relative scale error of the instrument"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Stretch and its derivative by s."""
        return linear(batch, values, [Derivative(0, scale=np.ones(len(batch)))])
