"""Empirical tier: a smooth error curve over the range that a joint moved. A shape, not a cause."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.joint_curve import JointCurve
from kilter_core.effects.over_range import OverRange
from kilter_core.effects.physical import JOINT_CURVE
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class UnknownSmoothCurve(JointCurve, OverRange):
    """dq = Σ a_m P_m(u) over the ``orders`` m: Legendre polynomials of u = (q − centre)/half, −1 to 1 over the range.

    Over less than one turn q, sin q and cos q span every smooth curve, so
    that the torque of a hose or an error of a belt would pass for a scale error and an eccentricity.
    """

    id = "unknown_smooth_curve"
    summary = "smooth error curve of a joint without a known cause"
    physical = JOINT_CURVE
    source = "empirical: Legendre polynomials on the range that the joint moved"
    aliases = ("encoder_scale", "eccentricity", "second_harmonic", "gravity_spring")
    remedy = "sweep the joint alone in small steps over its whole range, best over more than one turn"
    empirical = True
    alone = False

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Order by order."""
        return [{"orders": (m,)} for m in cls().orders]

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """Orders 1 and 2, and so on up to all: the first alone is a scale error."""
        return [tuple(tried[:most]) for most in range(2, len(tried) + 1)]

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m per joint, order by order, rad."""
        sigma, wide = math.radians(0.05), math.radians(0.5)
        stems = [f"smooth{m}" for m in self.orders]
        made = (self.per_joint(robot, stem, "rad", sigma, -wide, wide, "empirical amplitude") for stem in stems)
        return tuple(p for stem in made for p in stem)

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Polynomials, order by order."""
        curves = np.zeros((len(self.orders), *q.shape))
        curves[:, :, list(self.acting(q.shape[1]))] = self.shapes(q)
        return list(curves)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a polynomial for each joint."""
        joints = self.acting(len(form.joints))
        for place, (j, *range_of) in enumerate(zip(joints, self.centres or (), self.halves or (), strict=True)):
            powers = self.powers(values[place :: len(joints)])
            form.curve(j, Shape.POLYNOMIAL, 1.0, constants=tuple(range_of), powers=powers)
