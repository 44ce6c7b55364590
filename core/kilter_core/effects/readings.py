"""Errors of a joint's reading: scale, offset by angle, coupling, tilt and local bumps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.curves import JointCurve
from kilter_core.effects.physical import (
    JOINT_CURVE,
    JOINT_FOLLOWS,
    JOINT_SCALE,
    JOINT_TWIST,
    SMOOTH_CURVE,
    PhysicalClass,
    Separator,
)
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

HALVES = (0.18, 0.44)  # half-widths that are tried, rad: 10 and 25 degrees
INSIDE = 0.7  # of the half-width: within it are more than a quarter of the height
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


@dataclass(frozen=True)
class Harmonic(JointCurve):
    """dq = a sin m q + b cos m q, m times per revolution of the joint."""

    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Whitney, Lozinski and Rourke 1986; Hu 2020, harmonic model of joint modules"
    order: ClassVar[int]
    sigma: ClassVar[float]  # rad

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a then b per joint, rad."""
        sigma, wide = self.sigma, 10.0 * self.sigma
        angle = "q" if self.order == 1 else f"{self.order}q"
        return tuple(
            p
            for wave in ("sin", "cos")
            for p in self.per_joint(
                robot, f"{self.id}_{wave}", "rad", sigma, -wide, wide, f"amplitude of {wave} {angle}"
            )
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Sine and cosine."""
        return np.sin(self.order * q), np.cos(self.order * q)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a wave for each joint."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [(float(self.order),)] * len(joints))


@dataclass(frozen=True)
class Eccentricity(Harmonic):
    """dq = a sin q + b cos q, once per revolution of the joint.

    The cosine is b at q = 0 and so partly an encoder offset: separating them is the geometric fit's business.
    """

    id = "eccentricity"
    summary = "once-per-revolution error of a joint: encoder disc or output gear off centre"
    aliases = ("encoder_scale", "gravity_spring", "second_harmonic", "axial_compliance")
    remedy = "move the joint over more than 180 degrees; repeat poses with a second payload, which it ignores"
    order, sigma = 1, math.radians(0.1)


@dataclass(frozen=True)
class SecondHarmonic(Harmonic):
    """dq = a sin 2q + b cos 2q, twice per revolution of the joint."""

    id = "second_harmonic"
    summary = "twice-per-revolution error of a joint: coupling or ovality"
    aliases = ("eccentricity", "encoder_scale", "gravity_spring")
    remedy = "move the joint over more than 180 degrees: on a short range it looks like the first harmonic"
    order, sigma = 2, math.radians(0.05)


@dataclass(frozen=True)
class ReadingTilt(Effect):
    """dq = kx ηx + ky ηy: the joint tilts in proportion to the load across it, and its encoder reads part of that as rotation.

    The thesis leaves open how tilting changes the readings; to first order a head at a fixed place of the joint sees
    one component of the tilt, whose direction kx and ky give.
    """

    id = "reading_tilt"
    summary = "encoder reads the tilt of its own joint as rotation"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = (
        "thesis, future work: encoder readings affected by the tilt of the joint; first order in the load across it"
    )
    needs = frozenset({"moments"})
    reads = (("wrench", (3, 4)),)
    in_part = (
        True  # load about one direction across a last joint is often next to nothing: the other is seen all the same
    )
    aliases = ("axial_compliance", "radial_compliance", "clearance_tilt", "eccentricity")
    remedy = "put a second encoder head opposite the first: the mean of both does not see the tilt"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Sensitivities kx, then ky per joint, rad/(N m) (m/N m for a prismatic joint)."""
        text = "reading by the load moment about "
        return tuple(
            p
            for k in "xy"
            for p in self.per_joint(robot, f"reading_tilt_{k}", "rad/(N m)", 3e-5, -5e-3, 5e-3, text + k)
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by kx and ky."""
        return self.joint_angle(batch, values, batch.moment[:, :, 0], batch.moment[:, :, 1])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add what a load across the axis adds to the joint itself, linear in that load."""
        joints = self.acting(len(form.joints))
        for place, j in enumerate(joints):
            rotations = np.zeros((6, 6))
            rotations[5 if form.robot.joints[j].kind == "revolute" else 2, 3:5] = values[place :: len(joints)]
            form.bend(j, rotations, np.zeros((6, 6)), np.zeros(3), of_axis=True)
        return True


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
