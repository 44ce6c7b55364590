"""Look-up curve of a joint reading: a magnet beside the axis of its chip, as low-cost drives have it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import option
from kilter_core.effects.joint_curve import JointCurve
from kilter_core.effects.physical import JOINT_CURVE, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

HIGHEST = 12
COUNTS = (4, 6, 8)  # harmonics that are tried together: one or two have causes of their own
POSES = 4  # of the rows, for each parameter


@dataclass(frozen=True)
class EncoderCurve(JointCurve):
    """dq = Σ a_m sin mq + b_m cos mq over the ``orders`` m, which together are one curve that repeats with the joint.

    A search tries the first 4, 6 and 8 orders together, as many as the poses can carry.
    """

    id = "encoder_curve"
    summary = "look-up curve of a joint reading: a magnet off the axis of its chip"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "ams AS5600 and AS5047 data sheets: error of a displaced magnet over one turn; Hu 2020, harmonic model"
    aliases = ("eccentricity", "second_harmonic", "unknown_joint_curve", "local_bump")
    remedy = "sweep the joint alone over a full turn, in steps of five degrees or less"
    alone = False
    supple = True

    orders: tuple[int, ...] = option((1, 2, 3, 4), "Waves per revolution that the curve is the sum of, 1 to 12.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            len(set(self.orders)) < len(self.orders)
            or not 1 <= min(self.orders, default=0) <= max(self.orders) <= HIGHEST
        ):
            raise OptionError(
                f"encoder_curve has orders {self.orders!r}: give different ones from 1 to {HIGHEST}.", effect=self.id
            )

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Order by order, as many as the poses can carry; none where they carry no curve."""
        poses = len(np.unique(np.round(rows.q, 6), axis=0))
        able = [count for count in COUNTS if 2 * count * POSES <= poses]
        return [{"orders": (m,)} for m in range(1, max(able, default=0) + 1)]

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """The first orders, as one curve."""
        return [tuple(tried[:count]) for count in COUNTS if count <= len(tried)]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m then b_m per joint, order by order, rad: degrees where the magnet is far off the axis."""
        sigma, wide = math.radians(0.5), math.radians(10.0)
        stems = [(wave, m) for m in self.orders for wave in ("sin", "cos")]
        return tuple(
            p
            for wave, m in stems
            for p in self.per_joint(robot, f"encoder_{wave}{m}", "rad", sigma, -wide, wide, f"amplitude of {wave} {m}q")
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Sines and cosines, order by order."""
        return [wave(m * q) for m in self.orders for wave in (np.sin, np.cos)]

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add the waves of each joint."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [[float(m) for m in self.orders]] * len(joints))
