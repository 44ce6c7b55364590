"""A joint that follows another one: wrists whose motors drive through each other's gears."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_FOLLOWS, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

_UNITS = {  # of k and its prior sigma, by the kinds of the joint that follows and of the one that drives
    ("revolute", "revolute"): ("1", 1e-3),
    ("prismatic", "prismatic"): ("1", 1e-3),
    ("revolute", "prismatic"): ("rad/m", 1e-2),
    ("prismatic", "revolute"): ("m/rad", 1e-4),
}


@dataclass(frozen=True)
class JointCoupling(Effect):
    """dq_i = k q_j for each of the ``joints`` i, driven by ``drivers`` j: one each, without them the joint before i."""

    id = "joint_coupling"
    summary = "a joint follows another: residual coupling of a wrist"
    physical = JOINT_FOLLOWS
    separated_by = (Separator.TURN,)
    source = "wrist coupling: J5 with q4, J6 with q4 and q5"
    aliases = ("encoder_scale",)
    remedy = "move the two joints independently of each other"
    counted = ("joints", "drivers")

    drivers: tuple[int, ...] | None = option(
        None, "For each of the joints the joint that it follows, from 1; null: the one before it."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drivers is not None and len(self.drivers) != len(self.joints or ()):
            raise OptionError("joint_coupling needs one driver for each of the joints it names.", effect=self.id)
        if any(i == j for i, j in zip(self.joints or (), self.drivers or (), strict=False)):
            raise OptionError("joint_coupling cannot drive a joint by itself: that is encoder_scale.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Each joint by the one before it, and by the one two before it: J6 follows q4."""
        return [{}, *({"joints": (j,), "drivers": (j - 2,)} for j in range(2, robot.n_joints))]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Name the joints and their drivers."""
        if self.drivers is not None:
            self.refuse_unknown(robot, (*self.drivers, *self.acting(robot.n_joints)))
            return self
        joints = self.restrict_to_joints(robot, range(1, robot.n_joints), "no joint before it drives it. Give drivers.")
        followers = joints.acting(robot.n_joints)
        return replace(self, joints=followers, drivers=tuple(j - 1 for j in followers))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Ratio k per pair, named ``coupling_q<driver>_<joint>``."""
        made = []
        for i, j in self._pairs():
            unit, sigma = _UNITS[robot.joints[i].kind, robot.joints[j].kind]
            wide, text = 50.0 * sigma, f"ratio at which joint {i + 1} follows joint {j + 1}"
            made.append(Parameter(f"coupling_q{j + 1}_{i + 1}", unit, 0.0, sigma, -wide, wide, text))
        return tuple(made)

    def joint_frequencies(self, n: int) -> tuple[tuple[int, float], ...]:
        """It follows its drivers."""
        return tuple((j, 1.0) for _, j in self._pairs())

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        return linear(batch, values, [Derivative(k, i, dq=batch.q[:, j]) for k, (i, j) in enumerate(self._pairs())])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a straight line by the driver of each joint."""
        places = zip(self.acting(len(form.joints)), values.tolist(), self.drivers or (), strict=True)
        for j, value, driver in places:
            form.curve(j, Shape.LINEAR, value, driver=driver)
        return True

    def _pairs(self) -> list[tuple[int, int]]:
        return list(zip(self.joints or (), self.drivers or (), strict=True))
