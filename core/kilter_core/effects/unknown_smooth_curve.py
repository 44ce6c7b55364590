"""Empirical tier: a smooth error curve over the range that a joint moved. A shape, not a cause."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.polynomial import legendre

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Batch, Effect, Local, option
from kilter_core.effects.physical import JOINT_CURVE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

HIGHEST = 12
FULL_RANGE = math.pi  # half of what a joint without limits counts as, when there are no rows


@dataclass(frozen=True)
class UnknownSmoothCurve(Effect):
    """dq = Σ a_m P_m(u) over the ``orders`` m: Legendre polynomials of u = (q − centre)/half, −1 to 1 over the range.

    ``centres`` and ``halves`` (rad, or m at a prismatic joint) hold the range of each of the ``joints``, from the rows;
    outside it the curve stays as it is at its end. Over less than one turn q, sin q and cos q span every smooth curve, so
    that the torque of a hose or an error of a belt would pass for a scale error and an eccentricity.
    """

    id = "unknown_smooth_curve"
    summary = "smooth error curve of a joint without a known cause"
    physical = JOINT_CURVE
    source = "empirical: Legendre polynomials on the range that the joint moved"
    aliases = ("encoder_scale", "eccentricity", "second_harmonic", "gravity_spring")
    remedy = "sweep the joint alone in small steps over its whole range, best over more than one turn"
    empirical = True

    orders: tuple[int, ...] = option((1, 2, 3, 4, 5), "Orders of the polynomials over the range of the joint.")
    centres: tuple[float, ...] | None = option(None, "Middle of each joint's range, rad or m; null: from the rows.")
    halves: tuple[float, ...] | None = option(None, "Half of each joint's range, rad or m; null: from the rows.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            not self.orders
            or len(set(self.orders)) < len(self.orders)
            or not 1 <= min(self.orders) <= max(self.orders) <= HIGHEST
        ):
            raise OptionError(
                f"unknown_smooth_curve has orders {self.orders!r}: give different ones from 1 to {HIGHEST}.",
                effect=self.id,
            )

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Take the range of each joint from the rows, or from its limits where there are none.

        Raises:
            OptionError: a named joint did not move, or ranges that are not those of the joints.

        """
        self.refuse_unknown(robot, self.joints or ())
        if self.centres is not None and self.halves is not None:
            return self._with_ranges(robot)
        if rows is None or not len(rows):
            return self
        low, high = rows.q.min(axis=0), rows.q.max(axis=0)
        moving = [int(j) for j in np.flatnonzero(high > low)]
        chosen = self.limited(robot, moving, "it did not move in these rows. Name joints that moved.")
        joints = chosen.acting(robot.n_joints)
        centres = tuple(float(low[j] + high[j]) / 2.0 for j in joints)
        return replace(
            chosen, joints=joints, centres=centres, halves=tuple(float(high[j] - low[j]) / 2.0 for j in joints)
        )

    def _with_ranges(self, robot: Robot) -> Self:
        joints, centres, halves = self.acting(robot.n_joints), self.centres or (), self.halves or ()
        if not len(joints) == len(centres) == len(halves) or any(h <= 0.0 for h in halves):
            raise OptionError(
                f"unknown_smooth_curve needs a centre and a half above 0 for each of {len(joints)} joints.",
                effect=self.id,
            )
        return self

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m per joint, order by order, rad."""
        sigma, wide = math.radians(0.05), math.radians(0.5)
        stems = [f"smooth{m}" for m in self.orders]
        made = (self.per_joint(robot, stem, "rad", sigma, -wide, wide, "empirical amplitude") for stem in stems)
        return tuple(p for stem in made for p in stem)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        joints = self.acting(batch.q.shape[1])
        if self.centres is None or self.halves is None:
            raise OptionError(
                "unknown_smooth_curve needs centres and halves: give the range of each joint.", effect=self.id
            )
        u = np.zeros_like(batch.q)
        scaled = (batch.q[:, list(joints)] - np.array(self.centres)) / np.array(self.halves)
        u[:, list(joints)] = np.clip(scaled, -1.0, 1.0)
        return self.joint_angle(batch, values, *(legendre.legval(u, np.eye(m + 1)[m]) for m in self.orders))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add a polynomial for each joint."""
        joints = self.acting(len(form.joints))
        for place, (j, *range_of) in enumerate(zip(joints, self.centres or (), self.halves or (), strict=True)):
            series = np.zeros(max(self.orders) + 1)
            series[list(self.orders)] = values[place :: len(joints)]
            powers = tuple(legendre.leg2poly(series).tolist())
            form.curve(j, Shape.POLYNOMIAL, 1.0, constants=tuple(range_of), powers=powers)
        return True
