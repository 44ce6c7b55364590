"""Second-order error of a joint reading: a coupling, an oval gear or bearing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.joint_curve import JointCurve
from kilter_core.effects.physical import JOINT_CURVE, Separator
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class SecondHarmonic(JointCurve):
    """dq = a sin 2q + b cos 2q, twice per revolution of the joint."""

    id = "second_harmonic"
    summary = "twice-per-revolution error of a joint: coupling or ovality"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Whitney, Lozinski and Rourke 1986; Hu 2020, harmonic model of joint modules"
    aliases = ("eccentricity", "encoder_scale", "gravity_spring")
    remedy = "move the joint over more than 180 degrees: on a short range it looks like the first harmonic"

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a then b per joint, rad."""
        sigma, wide = math.radians(0.05), math.radians(0.5)
        return tuple(
            p
            for wave in ("sin", "cos")
            for p in self.per_joint(
                robot, f"second_harmonic_{wave}", "rad", sigma, -wide, wide, f"amplitude of {wave} 2q"
            )
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Sine and cosine."""
        return np.sin(2.0 * q), np.cos(2.0 * q)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a wave for each joint."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [(2.0,)] * len(joints))
