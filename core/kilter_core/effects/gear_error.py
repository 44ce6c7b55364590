"""Transmission error of a gear: cyclic in the revolutions of the motor, not of the joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_CURVE, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class GearError(Effect):
    """dq = a sin(k N q) + b cos(k N q) for each of the ``orders`` k, with gear ratio N.

    ``ratios`` N belong to ``joints``, one each; without them they come from the robot. Strain wave gears err once and
    twice per turn of the wave generator, which are the orders 1 and 2; an order may be a fraction.
    """

    id = "gear_error"
    summary = "cyclic transmission error of the gear at multiples of the motor's turn"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Jia 2021, strain wave gears at 1x and 2x of the wave generator"
    aliases = ("unknown_joint_curve",)
    remedy = "know the gear ratio exactly, and measure the joint at several angles within one turn of its motor"

    orders: tuple[float, ...] = option((1, 2), "Multiples of the motor's turn; fractions are allowed.")
    ratios: tuple[float, ...] | None = option(None, "Gear ratios of the joints named; null: the robot's.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.orders or min(self.orders) <= 0:
            raise OptionError("gear_error needs orders above 0, such as 1 and 2.", effect=self.id)
        if self.ratios is not None and len(self.ratios) != len(self.joints or ()):
            raise OptionError("gear_error needs one ratio for each of the joints it names.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the joints whose gear ratio is known, with the robot's ratios unless there are own ones.

        Raises:
            OptionError: no gear ratio is known.

        """
        if self.ratios is not None:
            return self.revolute(robot)
        geared = {j: x.gear_ratio for j, x in enumerate(robot.joints) if x.gear_ratio and x.kind == "revolute"}
        why = "its gear ratio is not known. Give gear_ratio in the robot's joints, or joints with ratios."
        chosen = self.restrict_to_joints(robot, geared, why)
        joints = chosen.acting(robot.n_joints)
        return replace(chosen, joints=joints, ratios=tuple(float(geared[j] or 0.0) for j in joints))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a then b per joint, order by order, rad."""
        sigma, wide = math.radians(0.02), math.radians(0.2)
        names = [(wave, f"{order:g}") for order in self.orders for wave in ("sin", "cos")]
        return tuple(
            p
            for wave, k in names
            for p in self.per_joint(robot, f"gear_{wave}{k}", "rad", sigma, -wide, wide, f"amplitude of {wave} {k} N q")
        )

    def joint_frequencies(self, n: int) -> tuple[tuple[int, float], ...]:
        """It repeats with the motor, not with the joint."""
        slowest = min(self.orders)
        return tuple((j, slowest * ratio) for j, ratio in zip(self.acting(n), self.ratios or (), strict=True))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        turns = np.zeros_like(batch.q)
        joints = list(self.acting(batch.q.shape[1]))
        turns[:, joints] = batch.q[:, joints] * np.asarray(self.ratios)
        waves = [wave(k * turns) for k in self.orders for wave in (np.sin, np.cos)]
        return self.joint_angle(batch, values, *waves)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the waves of each gear."""
        ratios = self.ratios or ()
        form.waves(
            self.acting(len(form.joints)), values, [[order * ratio for order in self.orders] for ratio in ratios]
        )
        return True
