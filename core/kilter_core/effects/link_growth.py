"""Growth of a single link with temperature: the one with the motor in it, or the one of plastic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_temperature import LawOfTemperature
from kilter_core.effects.physical import THERMAL, Separator
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SHORTEST_M = 1e-6


@dataclass(frozen=True)
class LinkGrowth(LawOfTemperature):
    """The link after joint i grows by α (T − T0) of its length, the others do not; ``reference_c`` is T0.

    All links together are ``thermal_growth``, which also takes the column under the first joint with it.
    """

    id = "link_growth"
    summary = "one link grows with temperature"
    physical = THERMAL
    separated_by = (Separator.TEMPERATURE,)
    source = "linear expansion; Yin et al. 2014: links beside motors warm up alone"
    signs = "positive"
    aliases = ("thermal_growth", "zero_thermal", "drift")
    remedy = "revisit the same poses cold and warm, with the link stretched out and folded back"

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length."""
        lengths = np.linalg.norm(robot.chain.link_vectors[:-1], axis=1)
        long = [int(j) for j in np.flatnonzero(lengths > SHORTEST_M)]
        return self.restrict_to_joints(robot, long, "its link has no length. Name the joint before a long link.")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coefficient of expansion α per link, 1/K; steel has 12e-6, aluminium 23e-6."""
        text = "coefficient of expansion of the link after this joint"
        return self.per_joint(robot, "link_expansion", "1/K", 2e-5, 0.0, 1e-4, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, and the derivative."""
        warmer = self.warmer(batch)
        derivatives = []
        for k, j in enumerate(self.acting(batch.q.shape[1])):
            xi = np.zeros((len(batch), 6))
            xi[:, :3] = warmer[:, None] * batch.link_vectors[j]
            derivatives.append(Derivative(k, j, xi=xi))
        return linear(batch, values, derivatives)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the growth of each link at the temperature of now."""
        warmer = self.warmer_now(form)
        if warmer is None:
            return False
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.twist(j, value * warmer * form.robot.chain.link_vectors[j])
        return True
