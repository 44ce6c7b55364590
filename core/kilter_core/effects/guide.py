"""Guides of prismatic joints: how the carriage leaves its line and rotates along its travel."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import TWIST, Derivative, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.curves import OverRange
from kilter_core.effects.physical import GUIDE
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


@dataclass(frozen=True)
class GuideRotation(GuideCurves):
    """The carriage of prismatic joint i rotates by a smooth curve of the reading: pitch and yaw about x and y, roll about z.

    Its axes are those of the joint frame, its centre the origin of that frame. A constant rotation is geometry, so the
    orders begin at 1: a guide of constant curvature or twist. As with a straightness the name does not say why.
    """

    id = "guide_rotation"
    summary = "carriage of a prismatic joint pitches, yaws and rolls along the travel"
    physical = GUIDE
    source = "ISO 230-1, angular errors of a linear axis (EAX, EBX, ECX)"
    aliases = ("straightness", "telescope_bending", "encoder_scale", "joint_coupling")
    remedy = "put an inclinometer or three reflectors on the carriage and run it over its whole travel"
    stem, components, sigma, wide = "guide", (3, 4, 5), 1e-4, 5e-3

    orders: tuple[int, ...] = option((1, 2, 3), "Orders of the polynomials over the range of the joint.")


@dataclass(frozen=True)
class Straightness(GuideCurves):
    """The carriage of prismatic joint i moves across its axis by a smooth curve of the reading, in x and y of the joint frame.

    A shift that is constant or proportional to the travel is geometry, so the orders begin at 2. The name says what the
    carriage does and not why: nothing needs to separate it from a cause.
    """

    id = "straightness"
    summary = "carriage of a prismatic joint moves across its axis along the travel"
    physical = GUIDE
    source = "ISO 230-1, straightness errors of a linear axis (EYX, EZX)"
    aliases = ("guide_rotation", "telescope_bending", "unknown_field")
    remedy = "run the carriage over its whole travel in small steps, in two postures of the joints behind it"
    lowest: ClassVar[int] = 2
    stem, components, sigma, wide = "straight", (0, 1), 1e-4, 5e-3

    orders: tuple[int, ...] = option((2, 3), "Orders of the polynomials over the range of the joint.")
