"""First-order error of a joint reading: an encoder disc or an output gear off its centre."""

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
class Eccentricity(JointCurve):
    """dq = a sin q + b cos q, once per revolution of the joint.

    The cosine is b at q = 0 and so partly an encoder offset: separating them is the geometric fit's business.
    """

    id = "eccentricity"
    summary = "once-per-revolution error of a joint: encoder disc or output gear off centre"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Whitney, Lozinski and Rourke 1986; Hu 2020, harmonic model of joint modules"
    aliases = ("encoder_scale", "gravity_spring", "second_harmonic", "axial_compliance")
    remedy = "move the joint over more than 180 degrees; repeat poses with a second payload, which it ignores"

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a then b per joint, rad."""
        sigma, wide = math.radians(0.1), math.radians(1.0)
        return tuple(
            p
            for wave in ("sin", "cos")
            for p in self.per_joint(robot, f"eccentricity_{wave}", "rad", sigma, -wide, wide, f"amplitude of {wave} q")
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Sine and cosine."""
        return np.sin(q), np.cos(q)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a wave for each joint."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [(1.0,)] * len(joints))
