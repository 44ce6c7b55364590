"""Gravity compensator: the pull of a balancer spring bends its joint, whatever the payload."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import option
from kilter_core.effects.joint_curve import JointCurve
from kilter_core.effects.physical import JOINT_CURVE, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class GravitySpring(JointCurve):
    """Joint compliance times the torque of a spring between two pins about the joint's axis; joint 2 unless named.

    With the pins at distances a and b (``arms_m``) and the angle q + φ between them (``angle_rad`` φ), the spring is
    s = √(a² + b² − 2ab cos(q + φ)) long and pulls with k (s − s0), s0 the ``free_length_m``. Its torque is minus the
    slope of its energy, so dq = −w sin(q + φ) (1 − s0/s) with w = c k a b: one parameter.

    Without ``arms_m`` the pins are unknown and s0 is taken as zero: dq = a sin q + b cos q, the same as eccentricity.
    """

    id = "gravity_spring"
    summary = "torque of a balancer spring through the compliance of its joint"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Klimchik et al. 2013, arXiv 1311.6674 and 1311.6810"
    aliases = ("eccentricity", "encoder_scale", "axial_compliance", "second_harmonic")
    remedy = "give the spring's pins and free length, move the joint over its whole range, add a second payload"

    arms_m: tuple[float, float] | None = option(
        None,
        "Distances of the spring's two pins from the axis, m; null: the effect cannot be distinguished from eccentricity.",
    )
    angle_rad: float = option(0.0, "Angle between the pins at q = 0, rad.")
    free_length_m: float = option(0.0, "Length of the spring without load, m, 0 or more.", low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arms_m is not None and (len(self.arms_m) != 2 or min(self.arms_m) <= 0 or len(set(self.arms_m)) == 1):
            raise OptionError("gravity_spring needs arms_m of two different distances above 0.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on joint 2, where balancers are, unless joints are named."""
        usual = (min(1, robot.n_joints - 1),)
        return (self if self.joints is not None else replace(self, joints=usual)).revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitude w per joint; with unknown pins the amplitudes a then b of sine and cosine. All rad."""
        sigma, wide = math.radians(0.1), math.radians(1.0)
        if self.arms_m is not None:
            return self.per_joint(robot, "gravity_spring", "rad", sigma, 0.0, wide, "amplitude w = c k a b")
        return tuple(
            p
            for wave in ("sin", "cos")
            for p in self.per_joint(
                robot, f"gravity_spring_{wave}", "rad", sigma, -wide, wide, f"amplitude of {wave} q"
            )
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """The pull of the spring; sine and cosine where its pins are unknown."""
        if self.arms_m is None:
            return np.sin(q), np.cos(q)
        a, b = self.arms_m
        angle = q + self.angle_rad
        length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(angle))
        return (-np.sin(angle) * (1.0 - self.free_length_m / length),)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add the pull of the spring, a wave where its pins are unknown."""
        joints = self.acting(len(form.joints))
        if self.arms_m is None:
            form.waves(joints, values, [(1.0,)] * len(joints))
            return
        for j, value in zip(joints, values.tolist(), strict=True):
            constants = (*self.arms_m, self.angle_rad, self.free_length_m)
            form.curve(j, Shape.SPRING, value, constants=constants)
