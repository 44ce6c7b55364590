"""Empirical tier: an error curve of one joint that no known effect explains. A shape, not a cause."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Effect, Local, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_CURVE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class UnknownJointCurve(Effect):
    """dq = Σ a_m sin mq + b_m cos mq over the ``orders`` m, plus d sin q sin q_p when there is a ``partner`` p.

    Orders 1 and 2 have physical causes with names of their own. For the product alone give no orders: ``orders=()``.
    """

    id = "unknown_joint_curve"
    summary = "error curve of a joint without a known cause"
    physical = JOINT_CURVE
    source = "empirical: cyclic orders 3 to 6, and the product of the sines of two joints"
    aliases = ("second_harmonic", "gear_error")
    remedy = "sweep the joint alone in small steps in both directions, and look at the curve"
    empirical = True
    counted = ("joints", "partner")

    orders: tuple[int, ...] = option((3, 4, 5, 6), "Waves per revolution; empty: only the product with the partner.")
    partner: int | None = option(None, "Joint whose angle multiplies the curve, from 1; null: none.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.partner in (self.joints or ()):
            raise OptionError("unknown_joint_curve needs a partner other than the joint itself.", effect=self.id)
        if not self.orders and self.partner is None:
            raise OptionError("unknown_joint_curve needs orders, a partner, or both.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Order by order, and each product with a partner."""
        alone = [{"orders": (m,)} for m in cls().orders]
        return [*alone, *({"orders": (), "partner": p} for p in range(robot.n_joints))]

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """All orders at once."""
        waves = tuple(one for one in tried if one.orders)
        return [waves] if len(waves) > 1 else []

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints, the partner aside."""
        if self.partner is None:
            return self.revolute(robot)
        UnknownJointCurve(joints=(self.partner,)).revolute(robot)  # the partner must exist, and be revolute
        chosen = UnknownJointCurve(joints=self.joints).revolute(robot).acting(robot.n_joints)
        return replace(self, joints=tuple(j for j in chosen if j != self.partner))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m then b_m per joint, order by order, then d; all rad."""
        stems = [f"curve_{wave}{m}" for m in self.orders for wave in ("sin", "cos")]
        stems += [] if self.partner is None else [f"curve_with{self.partner + 1}"]
        sigma, wide = math.radians(0.05), math.radians(0.5)
        made = (self.per_joint(robot, stem, "rad", sigma, -wide, wide, "empirical amplitude") for stem in stems)
        return tuple(p for stem in made for p in stem)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        signals = [wave(m * batch.q) for m in self.orders for wave in (np.sin, np.cos)]
        if self.partner is not None:
            signals.append(np.sin(batch.q) * np.sin(batch.q[:, [self.partner]]))
        return self.joint_angle(batch, values, *signals)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the waves, and the product with the partner."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [[float(m) for m in self.orders]] * len(joints))
        if self.partner is not None:
            for j, value in zip(joints, values[len(values) - len(joints) :].tolist(), strict=True):
                form.curve(j, Shape.SINES, value, driver=self.partner)
        return True
