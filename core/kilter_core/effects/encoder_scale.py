"""Scale of a joint reading: a gear ratio or an encoder pitch that is not what the controller believes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.joint_curve import JointCurve
from kilter_core.effects.physical import JOINT_SCALE, SMOOTH_CURVE, PhysicalClass, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class EncoderScale(JointCurve):
    """dq = k q: the joint moves (1 + k) times what it reads."""

    id = "encoder_scale"
    summary = "scale error of a joint reading: gear ratio or encoder pitch"
    physical = SMOOTH_CURVE
    separated_by = (Separator.TURN,)
    source = "Whitney, Lozinski and Rourke 1986"
    aliases = ("eccentricity", "gravity_spring", "second_harmonic")
    remedy = "move the joint over its whole range, best over more than one turn"

    def physical_class(self, robot: Robot) -> PhysicalClass:
        """A straight line is what the pitch of a prismatic joint does; of a revolute joint it is a shape like any other."""
        return JOINT_SCALE if self._slides(robot) else self.physical

    def separators(self, robot: Robot) -> tuple[Separator, ...]:
        """A prismatic joint needs none: whatever errs in proportion to its travel is its scale."""
        return () if self._slides(robot) else self.separated_by

    def _slides(self, robot: Robot) -> bool:
        return all(robot.joints[j].kind == "prismatic" for j in self.acting(robot.n_joints))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Relative scale error k per joint."""
        return self.per_joint(robot, "encoder_scale", "1", 1e-3, -0.02, 0.02, "relative scale error k")

    def signals(self, q: Floats) -> Sequence[Floats]:
        """The angle itself."""
        return (q,)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a straight line for each joint."""
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.LINEAR, value)
