"""Backlash, clearance, friction and tooth errors of a joint and its gear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import SOFTENING, Derivative, Effect, Local, SignedByLoad, joint_twists, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import JOINT_CURVE, JOINT_TILT, JOINT_TWIST, REVERSAL, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Backlash(Effect):
    """dq = b s / 2 with s in {-1, 0, +1} the direction of the joint's last motion.

    A joint that lags behind its motor has b < 0 in this convention; the sign is left to the data.
    """

    id = "backlash"
    summary = "reversal error with the direction of the joint's last motion"
    physical = REVERSAL
    separated_by = (Separator.FRICTION,)
    source = "gap-finder library; Slamani, Nubiola and Bonev 2012"
    needs = frozenset({"direction"})
    sided = True
    aliases = ("friction_windup", "backlash_load")
    remedy = "approach the same poses from both sides with every joint: one-sided, it is an encoder offset"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Reversal width b per joint, rad."""
        wide = math.radians(1.0)
        return self.per_joint(robot, "backlash", "rad", math.radians(0.1), -wide, wide, "reversal width b")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b.

        Raises:
            ObservationError: the rows have no direction.

        """
        return self.joint_angle(batch, values, self.column(batch, "direction") / 2.0)

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Half the width either way, in rows that a joint came to from a side that nobody knows."""
        if batch.direction is None:
            return ()
        acting = ((k, j, batch.direction[:, j] == 0.0) for k, j in enumerate(self.acting(batch.q.shape[1])))
        return tuple(
            Derivative(k, j, dq=0.5 * values[k] * unknown) for k, j, unknown in acting if values[k] and unknown.any()
        )

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("reversal", self.acting(len(form.joints)), values)
        return True


PRIOR_SIGMA = (
    "Standard deviation of the prior of half the backlash, rad (of a prismatic joint per 0.1 m). Where the load keeps its sign "
    "the prior decides between backlash and the joint's zero: say 0.017 for hobby servos."
)
NO_MOMENT_NM = 1e-9  # below this the sign would be that of rounding noise


@dataclass(frozen=True)
class BacklashLoad(SignedByLoad):
    """dq = b sign(ηz): the load rests the gear on one flank. ``softening_nm`` > 0 makes the sign a tanh."""

    id = "backlash_load"
    summary = "backlash on the side of the axial load moment"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 5.19"
    needs = frozenset({"moments"})
    sided = about = True
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("axial_compliance", "eccentricity", "backlash")
    remedy = "measure poses where the load on the joint has both signs, or the same poses with another payload"

    softening_nm: float | tuple[float, ...] = option(0.0, SOFTENING, low=0.0)
    prior_sigma_rad: float = option(math.radians(0.1), PRIOR_SIGMA, low=1e-6, high=0.035)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Backlash b per joint, rad."""
        return self.per_joint(robot, "backlash_load", "rad", self.prior_sigma_rad, 0.0, math.radians(1.0), "backlash b")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b."""
        return self.joint_angle(batch, values, self._sides(batch))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the backlash, where no other effect has one by the load."""
        return form.add_side(self.acting(len(form.joints)), values, self.softening_nm)

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Scatter of a sign s around its expectation, √(1 − s²), times b."""
        left = np.sqrt(1.0 - self._sides(batch) ** 2)
        acting = enumerate(self.acting(batch.q.shape[1]))
        return tuple(Derivative(k, j, dq=values[k] * left[:, j]) for k, j in acting if values[k] != 0.0)

    def _sides(self, batch: Batch) -> Floats:
        """On which flank each joint rests (N, n); 0 where the effect does not act."""
        joints = list(self.acting(batch.q.shape[1]))
        about = batch.sided_axial[:, joints]
        sides = np.zeros_like(batch.q)
        sides[:, joints] = np.where(np.abs(about) > NO_MOMENT_NM, self.soft_signs(batch, about), 0.0)
        return sides


@dataclass(frozen=True)
class ClearanceTilt(SignedByLoad):
    """The joint tilts by its clearance angle C about x and y of its frame.

    With t = tan C and γ the share of the load about x, δα = sign(ηx) t sin γ / √(1 + (t sin γ)²) and
    δβ = sign(ηy) t cos γ / √(1 + (t cos γ)²): L of eq. 5.17-5.18 drops out once 5.15 is corrected to r = (L/2) tan C.
    ``share`` "thesis" is eq. 5.16, γ = (π/2)|ηx| / (|ηx| + |ηy|); "vector" is atan2(|ηx|, |ηy|), invariant when the
    joint frame is rotated about its axis. ``softening_nm`` > 0 replaces the sign by a tanh of that half-width.
    """

    id = "clearance_tilt"
    summary = "tilt of fixed size towards the transverse load, by joint clearance"
    physical = JOINT_TILT
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 5.16-5.18, 5.15 corrected"
    needs = frozenset({"moments"})
    sided = True
    about = False
    reads = (("wrench", (3, 4)),)
    signs = "positive"
    aliases = ("radial_compliance", "link_bending", "base_compliance")
    remedy = (
        "measure poses in which the transverse load rotates about the joint, or the same poses with another payload"
    )

    share: str = option(
        "thesis",
        "How the load is shared among x and y: `thesis` (eq. 5.16) or `vector`, independent of the joint frame's rotation.",
        choices=("thesis", "vector"),
    )
    softening_nm: float | tuple[float, ...] = option(0.0, SOFTENING, low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.share not in ("thesis", "vector"):
            raise OptionError(f"clearance_tilt has share {self.share!r}: give thesis or vector.", effect=self.id)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Clearance angle C per joint, rad."""
        return self.per_joint(
            robot, "clearance", "rad", math.radians(0.1), 0.0, math.radians(1.0), "clearance angle C", rotates=True
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist (0, 0, 0, δα, δβ, 0) per joint and its derivative by C."""
        rows, n = batch.q.shape
        joints = list(self.acting(n))
        t = np.array([math.tan(value) for value in values])
        xi, slopes = np.zeros((rows, n, 6)), np.zeros((rows, len(joints), 6))
        for column, (part, _) in zip((3, 4), self._directions(batch, joints), strict=True):
            scale = 1.0 / np.sqrt(1.0 + (t * part) ** 2)
            xi[:, joints, column] = t * part * scale
            slopes[:, :, column] = (1.0 + t * t) * part * scale**3
        return Local(xi=xi, derivatives=joint_twists(joints, slopes))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the tilts, where no other effect has one."""
        joints = self.acting(len(form.joints))
        if not form.free("tilt", joints):
            return False
        for j, value, width in zip(joints, values.tolist(), form.softening(self.softening_nm, joints), strict=True):
            joint = form.joints[j]
            joint.tilt, joint.tilt_softening_nm = math.tan(value), width
            joint.tilt_by_vector = self.share == "vector"
        return True

    def doubt(self, batch: Batch, values: Floats) -> tuple[Derivative, ...]:
        """Scatter of each sign s around its expectation, √(1 − s²), times the tilt."""
        out = []
        joints = list(self.acting(batch.q.shape[1]))
        sides = self._directions(batch, joints)
        for k, j in enumerate(joints):
            if values[k] == 0.0:
                continue
            for column, (_, left) in zip((3, 4), sides, strict=True):
                xi = np.zeros((len(batch), 6))
                xi[:, column] = math.tan(values[k]) * left[:, k]
                out.append(Derivative(k, j, xi=xi))
        return tuple(out)

    def _directions(self, batch: Batch, joints: list[int]) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Signed shares (N, A) of the tilts about x and about y, and how far each may be off; no load, no tilt."""
        moments = batch.sided_moment
        mx, my = moments[:, joints, 0], moments[:, joints, 1]
        ax, ay = np.abs(mx), np.abs(my)
        total = ax + ay
        # Rounding noise must not decide where a joint without transverse load tilts.
        loaded = total > 1e-9
        share = ax / np.where(loaded, total, 1.0)
        gamma = share * (math.pi / 2.0) if self.share == "thesis" else np.arctan2(ax, ay)
        sx, sy = (np.where(loaded, self.soft_signs(batch, m), 0.0) for m in (mx, my))
        along, beside = np.sin(gamma), np.cos(gamma)
        return (sx * along, along * np.sqrt(1.0 - sx**2)), (sy * beside, beside * np.sqrt(1.0 - sy**2))


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


WIDEST = math.radians(0.5)
WINDUP_PRIOR_SIGMA = (
    "Standard deviation of the prior of the wind-up, rad (of a prismatic joint per 0.1 m): that of a hobby servo is its "
    "friction over its stiffness, some 0.005."
)


@dataclass(frozen=True)
class FrictionWindup(Effect):
    """dq = k s with s the direction of the joint's last motion and |k| = friction torque over stiffness.

    In position data this is the same as ``backlash`` with b = 2k: only torque can distinguish them.
    """

    id = "friction_windup"
    summary = "wind-up of the drive by friction, on the side of the last motion"
    physical = REVERSAL
    separated_by = (Separator.FRICTION,)
    source = "Seyfferth, Maghzal and Angeles 1995; Tuttle 1992, harmonic drives"
    needs = frozenset({"direction"})
    sided = True
    aliases = ("backlash", "backlash_load")
    remedy = (
        "a log of joint torques (masses_from), and poses at two loads: in positions alone it is the same as backlash"
    )

    prior_sigma_rad: float = option(math.radians(0.05), WINDUP_PRIOR_SIGMA, low=1e-6, high=0.035)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Wind-up k per joint, rad."""
        wide = max(WIDEST, 3.0 * self.prior_sigma_rad)
        return self.per_joint(robot, "windup", "rad", self.prior_sigma_rad, -wide, wide, "wind-up k")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by k."""
        return self.joint_angle(batch, values, self.column(batch, "direction"))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the windups: each is half a reversal."""
        form.add("reversal", self.acting(len(form.joints)), 2.0 * values)
        return True
