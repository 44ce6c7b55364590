"""What a guide that is not perfect does to the carriage of a prismatic joint. Shared by effects; none itself."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import TWIST, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.over_range import OverRange
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class GuideCurves(OverRange):
    """The carriage moves by smooth curves of the reading in some components of its twist, in the axes of the joint frame."""

    stem: ClassVar[str]
    components: ClassVar[tuple[int, ...]]
    sigma: ClassVar[float]
    wide: ClassVar[float]
    unable = "it is an error of a guide, and the joint is revolute. Name prismatic joints."

    def able(self, robot: Robot) -> Collection[int]:
        """Prismatic joints."""
        return [j for j, joint in enumerate(robot.joints) if joint.kind == "prismatic"]

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes per joint, order by order and in each order component by component, m or rad."""
        self.refuse_unknown(robot, self.joints or ())
        made = []
        for m in self.orders:
            for name, unit in (TWIST[c] for c in self.components):
                text = f"the carriage's {'rotation about' if unit == 'rad' else 'shift along'} its {name[-1]}"
                made += [
                    Parameter(f"{self.stem}{m}_{name}_{j + 1}", unit, 0.0, self.sigma, -self.wide, self.wide, text)
                    for j in self.acting(robot.n_joints)
                ]
        return tuple(made)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the carriage and its derivatives by the amplitudes."""
        made: list[Derivative] = []
        joints = self.acting(batch.q.shape[1])
        for shape in self.shapes(batch.q):
            for component in self.components:
                for place, j in enumerate(joints):
                    xi = np.zeros((len(batch), 6))
                    xi[:, component] = shape[:, place]
                    made.append(Derivative(len(made), j, xi=xi))
        return linear(batch, values, made)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a polynomial for each component of each carriage."""
        joints = self.acting(len(form.joints))
        amplitudes = values.reshape(len(self.orders), len(self.components), len(joints))
        for place, (j, *range_of) in enumerate(zip(joints, self.centres or (), self.halves or (), strict=True)):
            for k, component in enumerate(self.components):
                powers = self.powers(amplitudes[:, k, place])
                form.curve(j, Shape.POLYNOMIAL, 1.0, twist=component, constants=tuple(range_of), powers=powers)
        return True
