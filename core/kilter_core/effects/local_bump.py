"""Local error of a joint: dirt or a scratch on its encoder, a dent or a worn tooth in its gear."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
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

HALVES = (0.18, 0.44)  # half-widths that are tried, rad: 10 and 25 degrees
INSIDE = 0.7  # of the half-width: within it are more than a quarter of the height
POSES = 4  # that must be there: fewer are readings that went wrong
POWERS = (1.0, 0.0, -2.0, 0.0, 1.0)  # of u in (1 − u²)²


@dataclass(frozen=True)
class LocalBump(Effect):
    """dq = h (1 − u²)² with u = (q − ``centre_rad``)/``half_width_rad`` between −1 and 1; nothing elsewhere."""

    id = "local_bump"
    summary = "local error of a joint, at one place of its encoder or gear"
    physical = JOINT_CURVE
    source = "encoder makers' manuals: contamination and scratches of a disc; ISO 10825, local damage of gear teeth"
    aliases = ("encoder_curve", "gear_error", "unknown_joint_curve")
    remedy = "sweep the joint alone through the place in small steps, in both directions"
    supple = True  # several beside one another are a curve of any shape
    rarer = 20.0  # it stands at one of so many places

    centre_rad: float = option(0.0, "Reading at the middle of the bump, rad.")
    half_width_rad: float = option(HALVES[0], "Reading from its middle to its end, rad, above 0.", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.half_width_rad > 0.0:
            raise OptionError(
                f"local_bump has half_width_rad {self.half_width_rad!r}: give rad above 0.", effect=self.id
            )

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Side by side at each joint, in two widths, where enough poses are."""
        turning = [j for j, joint in enumerate(robot.joints) if joint.kind == "revolute"]
        return [
            one
            for j in turning
            for half in HALVES
            for one in _bumps_along_joint(j, np.unique(rows.q[:, j].round(6)), half)
        ]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot, "it stands at an angle")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Height h per joint, rad; named with centre and half-width in hundredths of rad, for a joint may have several."""
        stem = f"bump_{100.0 * self.centre_rad:.0f}_{100.0 * self.half_width_rad:.0f}".replace("-", "m")
        wide = math.radians(1.0)
        return self.per_joint(robot, stem, "rad", math.radians(0.05), -wide, wide, "height of the bump")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by h."""
        u = np.clip((batch.q - self.centre_rad) / self.half_width_rad, -1.0, 1.0)
        return self.joint_angle(batch, values, (1.0 - u**2) ** 2)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a polynomial for each joint, which is held at its ends."""
        where = (self.centre_rad, self.half_width_rad)
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            form.curve(j, Shape.POLYNOMIAL, 1.0, constants=where, powers=tuple(value * power for power in POWERS))
        return True


def _bumps_along_joint(joint: int, q: Floats, half: float) -> Iterator[Mapping[str, Any]]:
    """Bumps of one width side by side over the readings ``q (K,)`` of a joint."""
    for step in range(math.floor(q.min() / half), math.ceil(q.max() / half) + 1):
        if np.sum(np.abs(q - step * half) < INSIDE * half) >= POSES:
            yield {"joints": (joint,), "centre_rad": round(step * half, 2), "half_width_rad": half}
