"""Curves that effects share: of a joint by its own angle, and smooth over the range that a joint moved.

Guides of prismatic joints: how the carriage leaves its line and rotates along its travel.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.polynomial import legendre

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import TWIST, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import GUIDE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
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


FADE = float(np.radians(10.0))  # beyond its range in which a curve fades, rad
MEAN_OF = 200  # angles of the range over which its mean is taken
TURN = 2.0 * np.pi
KNOWN = np.pi  # range of a joint from which on its waves are known at every angle: half a revolution


@dataclass(frozen=True)
class JointCurve(Effect):
    """An error of a joint that follows its own angle alone.

    With ``measured`` it holds in that range. Beyond it nobody knows its shape: within ``FADE`` it fades to its mean over
    the range, which the zero of the joint takes up where it is fitted without the curve.
    """

    measured: tuple[tuple[float, float], ...] | None = option(
        None, "Range of each joint, rad, beyond which the curve fades to its mean; null: it holds at every angle."
    )

    @abstractmethod
    def signals(self, q: Floats) -> Sequence[Floats]:
        """Derivatives (N, n) of the joint's error by each amplitude of a joint, at joints ``q (N, n)``."""

    @abstractmethod
    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add the curves as they are where they were measured."""

    def with_measured_range(self, q: Floats) -> Self:
        """The effect where rows ``q (N, n)`` measured it; over half a revolution or more it is known at every angle."""
        joints = self.acting(q.shape[1])
        low, high = q.min(axis=0), q.max(axis=0)
        turning = high - low >= KNOWN
        ends = np.where(turning, low - 10.0 * TURN, low), np.where(turning, high + 10.0 * TURN, high)
        return replace(self, measured=tuple((float(ends[0][j]), float(ends[1][j])) for j in joints))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        q = batch.q
        if self.measured is None:
            return self.joint_angle(batch, values, *self.signals(q))
        low, high = self._ends(q.shape[1])
        inside = np.clip(q, low, high)
        beyond = np.minimum(np.abs(q - inside) / FADE, 1.0)
        kept = 1.0 - beyond**2 * (3.0 - 2.0 * beyond)
        pairs = zip(self.signals(inside), self._means(q.shape[1]), strict=True)
        return self.joint_angle(batch, values, *(mean + kept * (signal - mean) for signal, mean in pairs))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the curves, within their range where one is stated."""
        first, n = len(form.curves), len(form.joints)
        self.add_curves(form, values)
        if self.measured is not None:
            joints, means = self.acting(n), self._means(n)
            amplitudes = values.reshape(len(means), len(joints))
            for place, (joint, ends) in enumerate(zip(joints, self.measured, strict=True)):
                mean = sum(float(a) * float(m[joint]) for a, m in zip(amplitudes[:, place], means, strict=True))
                form.bound_curves(first, joint, ends, FADE, mean)
        return True

    def _ends(self, n: int) -> tuple[Floats, Floats]:
        low, high, joints, ranges = np.zeros(n), np.zeros(n), self.acting(n), self.measured or ()
        if len(ranges) != len(joints) or any(len(ends) != 2 or ends[0] > ends[1] for ends in ranges):
            raise OptionError(
                f"{self.id} has measured {ranges!r}: give lowest and highest of {len(joints)} joints.", effect=self.id
            )
        for joint, ends in zip(joints, ranges, strict=True):
            low[joint], high[joint] = ends
        return low, high

    def _means(self, n: int) -> list[Floats]:
        """Mean (n,) of each signal over the range of each joint."""
        low, high = self._ends(n)
        share = (np.arange(MEAN_OF)[:, None] + 0.5) / MEAN_OF
        return [np.asarray(signal.mean(axis=0)) for signal in self.signals(low + share * (high - low))]


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
