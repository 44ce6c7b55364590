"""What is smooth over the range that a joint moved: Legendre polynomials of its reading. Shared by effects; none itself."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.polynomial import legendre

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Effect, option
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.types import Floats

HIGHEST = 12


@dataclass(frozen=True)
class OverRange(Effect):
    """An effect that is Σ a_m P_m(u) over the ``orders`` m, with u = (q − centre)/half, −1 to 1 over the range of a joint.

    ``centres`` and ``halves`` (rad, or m at a prismatic joint) hold the range of each of the ``joints``, from the rows;
    outside it the curve stays as it is at its end. Orders below ``lowest`` are something else.
    """

    lowest: ClassVar[int] = 1
    unable: ClassVar[str] = "the robot has no joints."

    orders: tuple[int, ...] = option((1, 2, 3, 4, 5), "Orders of the polynomials over the range of the joint.")
    centres: tuple[float, ...] | None = option(None, "Middle of each joint's range, rad or m; null: from the rows.")
    halves: tuple[float, ...] | None = option(None, "Half of each joint's range, rad or m; null: from the rows.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            not self.orders
            or len(set(self.orders)) < len(self.orders)
            or not self.lowest <= min(self.orders) <= max(self.orders) <= HIGHEST
        ):
            raise OptionError(
                f"{self.id} has orders {self.orders!r}: give different ones from {self.lowest} to {HIGHEST}.",
                effect=self.id,
            )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Take the range of each joint from the rows.

        Raises:
            OptionError: a named joint cannot have such a curve or did not move, or ranges that are not those of the joints.

        """
        possible = self.restrict_to_joints(robot, self.able(robot), self.unable)
        if self.centres is not None and self.halves is not None:
            return possible._with_ranges(robot)
        if rows is None or not len(rows):
            return possible
        low, high = rows.q.min(axis=0), rows.q.max(axis=0)
        moving = [j for j in self.able(robot) if high[j] > low[j]]
        chosen = self.restrict_to_joints(robot, moving, "it did not move in these rows. Name joints that moved.")
        joints = chosen.acting(robot.n_joints)
        centres = tuple(float(low[j] + high[j]) / 2.0 for j in joints)
        return replace(
            chosen, joints=joints, centres=centres, halves=tuple(float(high[j] - low[j]) / 2.0 for j in joints)
        )

    def able(self, robot: Robot) -> Collection[int]:
        """Joints that can have such a curve; ``unable`` says why the others cannot."""
        return range(robot.n_joints)

    def _with_ranges(self, robot: Robot) -> Self:
        joints, centres, halves = self.acting(robot.n_joints), self.centres or (), self.halves or ()
        if not len(joints) == len(centres) == len(halves) or any(h <= 0.0 for h in halves):
            raise OptionError(
                f"{self.id} needs a centre and a half above 0 for each of {len(joints)} joints.", effect=self.id
            )
        return self

    def shapes(self, q: Floats) -> Floats:
        """Polynomials (orders, N, joints) of the acting joints, order by order."""
        if self.centres is None or self.halves is None:
            raise OptionError(f"{self.id} needs centres and halves: give the range of each joint.", effect=self.id)
        joints = list(self.acting(q.shape[1]))
        u = np.clip((q[:, joints] - np.array(self.centres)) / np.array(self.halves), -1.0, 1.0)
        return np.stack([legendre.legval(u, np.eye(m + 1)[m]) for m in self.orders])

    def powers(self, amplitudes: Floats) -> tuple[float, ...]:
        """Coefficients of the powers of u of the sum, by the amplitude of each order."""
        series = np.zeros(max(self.orders) + 1)
        series[list(self.orders)] = amplitudes
        return tuple(legendre.leg2poly(series).tolist())
