"""What yields under load: joints about and across their axes, gears, the base, and balancer springs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.load_wrenches import axial_loads, row_load_wrenches
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import BASE, Derivative, Effect, Local, frame_twists, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.curves import JointCurve
from kilter_core.effects.physical import BASE_TILT, JOINT_CURVE, JOINT_TILT, JOINT_TWIST, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SOFTEST = 5.0  # times the compliance of a stated stiffness, which is a rough one


@dataclass(frozen=True)
class AxialCompliance(Effect):
    """dq = c ηz with c = 1/k >= 0; static or dynamic load, whichever the rows carry."""

    id = "axial_compliance"
    summary = "joint compliance about the axis, proportional to the load moment"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "thesis eq. 4.15, 5.19"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("link_bending", "radial_compliance", "gravity_spring", "eccentricity")
    remedy = "repeat old poses with a second payload: geometry cancels, the load does not"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance c per joint, rad/(N m) (m/N for a prismatic joint); of the size of a stiffness that the robot states."""
        made = self.per_joint(robot, "compliance", "rad/(N m)", 1e-4, 0.0, 1e-2, "axial compliance c = 1/k")
        stated = (robot.joints[j].drive_stiffness for j in self.acting(robot.n_joints))
        return tuple(one if k is None else _about(one, 1.0 / k) for one, k in zip(made, stated, strict=True))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by c."""
        return self.joint_angle(batch, values, batch.axial)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("compliance", self.acting(len(form.joints)), values)
        return True


def _about(parameter: Parameter, compliance: float) -> Parameter:
    """The parameter expected to be of this size, where that is more than is usual."""
    usual = max(parameter.prior_sigma, compliance)
    return replace(parameter, prior_sigma=usual, upper=max(parameter.upper, SOFTEST * compliance))


@dataclass(frozen=True)
class RadialCompliance(Effect):
    """The joint tilts by c (ηx, ηy) about x and y of its frame, c >= 0: a bearing equally stiff in all directions."""

    id = "radial_compliance"
    summary = "tilt of the bearing in proportion to the transverse load moment"
    physical = JOINT_TILT
    separated_by = (Separator.LOADS,)
    source = "Li, Gao and Liu 2020, axial and radial deformation of joints"
    needs = frozenset({"moments"})
    reads = (("wrench", (3, 4)),)
    signs = "positive"
    aliases = ("axial_compliance", "link_bending", "base_compliance", "clearance_tilt")
    remedy = "load the arm from the side or with a second payload, at many azimuths of the joint"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance c per joint, rad/(N m)."""
        text = "radial compliance c of the bearing"
        return self.per_joint(robot, "radial_compliance", "rad/(N m)", 1e-4, 0.0, 1e-2, text, rotates=True)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist (0, 0, 0, c ηx, c ηy, 0) per joint and its derivative by c."""
        across = np.zeros_like(batch.wrench)
        across[:, :, 3:5] = batch.moment[:, :, :2]
        acting = enumerate(self.acting(batch.q.shape[1]))
        return linear(batch, values, [Derivative(k, j, xi=across[:, j]) for k, j in acting])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("radial_compliance", self.acting(len(form.joints)), values)
        return True


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """The base frame rotates by (cx mx, cy my, 0) about its origin, m the load moment on the base."""

    id = "base_compliance"
    summary = "tilt of base or its mount under the moment of the arm"
    physical = BASE_TILT
    separated_by = (Separator.LOADS,)
    source = "base and mount compliance"
    needs = frozenset({"moments"})
    reads = (("base_wrench", (3, 4)),)
    stage = "base"
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "link_bending", "clearance_tilt")
    remedy = "measure a reflector on the base while the arm moves, or repeat poses with a second payload"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliances cx, cy about x and y of the base frame, rad/(N m)."""
        return tuple(
            Parameter(f"base_compliance_{k}", "rad/(N m)", 0.0, 1e-5, 0.0, 1e-3, f"tilt of the base about its {k}")
            for k in "xy"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives."""
        tilts = np.zeros((2, len(batch), 6))
        tilts[0, :, 3] = batch.base_wrench[:, 3]
        tilts[1, :, 4] = batch.base_wrench[:, 4]
        return frame_twists(batch, values, BASE, tilts)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the compliances of the base mount."""
        x, y = form.base_compliance or (0.0, 0.0)
        form.base_compliance = (x + float(values[0]), y + float(values[1]))
        return True


@dataclass(frozen=True)
class DirectionCompliance(Effect):
    """dq = h s ηz with s the direction of the joint's last motion: c + h after moving up, c − h after moving down."""

    id = "direction_compliance"
    summary = "compliance differs with the direction of approach"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "hysteresis of gears, loading and unloading branch: Seyfferth et al. 1995; Tuttle 1992"
    needs = frozenset({"moments", "direction"})
    sided = True
    reads = (("axial", (0,)),)
    aliases = ("axial_compliance", "backlash", "backlash_load")
    remedy = "approach the same poses from both sides, with two payloads"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Difference h per joint, rad/(N m) (m/N for a prismatic joint)."""
        text = "compliance after moving up less the mean"
        return self.per_joint(robot, "direction_compliance", "rad/(N m)", 3e-5, -5e-3, 5e-3, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by h."""
        side = np.asarray(self.column(batch, "direction"), dtype=np.float64)
        return self.joint_angle(batch, values, side * batch.sided_axial)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("compliance_by_direction", self.acting(len(form.joints)), values)
        return True


@dataclass(frozen=True)
class Hardening(Effect):
    """dq = −h ηz |ηz| with h >= 0, beside the c ηz of ``axial_compliance``: what large loads twist less than small ones.

    It has no meaning alone, and none beyond the load at which c ηz − h ηz |ηz| has its extremum.
    """

    id = "hardening"
    summary = "gear gets stiffer under load, beside its compliance"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "Harmonic Drive: stiffness K1 < K2 < K3 by load; the curve's first two terms"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("axial_compliance", "backlash_load", "direction_compliance")
    remedy = "repeat poses with three payloads or more, one of them none"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Hardening h per joint, rad/(N m)² (m/N² for a prismatic joint)."""
        return self.per_joint(robot, "hardening", "rad/(N m)2", 1e-5, 0.0, 1e-3, "hardening of the compliance")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by h."""
        return self.joint_angle(batch, values, -batch.axial * np.abs(batch.axial))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the values to their joints."""
        form.add("hardening", self.acting(len(form.joints)), values)
        return True


KNEES = (0.1, 0.2)  # that are tried, of the largest load on the joint: a larger one is as good as hardening
LEAST_LOAD_NM = 1e-3


@dataclass(frozen=True)
class StrainWave(Effect):
    """dq = b tanh(ηz/``knee_nm``) with b >= 0, beside the c ηz of ``axial_compliance``, the gear's stiffness at large loads.

    A maker states a stiffness K1 up to a torque T1, K2 up to T2 and K3 beyond; b is near T1 (1/K1 − 1/K3), and the knee
    lies between T1 and T2.
    """

    id = "strain_wave"
    summary = "gear softer at small loads than at large ones: a strain wave gear"
    physical = JOINT_TWIST
    separated_by = (Separator.LOADS,)
    source = "Harmonic Drive: stiffness K1 < K2 < K3 by load; Tuttle 1992, harmonic drives"
    needs = frozenset({"moments"})
    reads = (("axial", (0,)),)
    signs = "positive"
    aliases = ("hardening", "backlash_load", "axial_compliance")
    remedy = "repeat poses with three payloads or more, one of them none"
    rarer = float(len(KNEES))  # it has one of so many knees

    knee_nm: float = option(10.0, "Load at which the soft start ends, N m, above 0.", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.knee_nm > 0.0:
            raise OptionError(f"strain_wave has knee_nm {self.knee_nm!r}: give N m above 0.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Two knees at each revolute joint, within the loads that it bears in these rows."""
        largest = np.max(np.abs(axial_loads(robot, row_load_wrenches(robot, rows))), axis=0, initial=0.0)
        bearing = [j for j, x in enumerate(robot.joints) if x.kind == "revolute" and largest[j] > LEAST_LOAD_NM]
        return [{"joints": (j,), "knee_nm": float(f"{part * largest[j]:.2g}")} for j in bearing for part in KNEES]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints."""
        return self.revolute(robot, "it is a gear")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Twist b per joint, rad; named with the knee in N mm, for a search tries several."""
        stem = f"strain_wave_{1000.0 * self.knee_nm:.0f}"
        return self.per_joint(
            robot, stem, "rad", math.radians(0.02), 0.0, math.radians(1.0), "twist b below the knee of the load"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by b."""
        return self.joint_angle(batch, values, np.tanh(batch.axial / self.knee_nm))

    def smooth_over(self, load_nm: float) -> bool:
        """Whether the knee is wider than this."""
        return self.knee_nm > load_nm

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add it as a soft side by the load, where no other effect has one."""
        return form.add_side(self.acting(len(form.joints)), values, self.knee_nm)


@dataclass(frozen=True)
class GravitySpring(JointCurve):
    """Joint compliance times the torque of a spring between two pins about the joint's axis; joint 2 unless named.

    With the pins at distances a and b (``arms_m``) and the angle q + φ between them (``angle_rad`` φ), the spring is
    s = √(a² + b² − 2ab cos(q + φ)) long and pulls with k (s − s0), s0 the ``free_length_m``. Its torque is minus the
    slope of its energy, so dq = −w sin(q + φ) (1 − s0/s) with w = c k a b: one parameter.

    Without ``arms_m`` the pins are unknown and s0 is taken as zero: dq = a sin q + b cos q, the same as eccentricity.
    """

    id = "gravity_spring"
    summary = "torque of a balancer spring through the compliance of its joint"
    physical = JOINT_CURVE
    separated_by = (Separator.TURN,)
    source = "Klimchik et al. 2013, arXiv 1311.6674 and 1311.6810"
    aliases = ("eccentricity", "encoder_scale", "axial_compliance", "second_harmonic")
    remedy = "give the spring's pins and free length, move the joint over its whole range, add a second payload"

    arms_m: tuple[float, float] | None = option(
        None,
        "Distances of the spring's two pins from the axis, m; null: the effect cannot be distinguished from eccentricity.",
    )
    angle_rad: float = option(0.0, "Angle between the pins at q = 0, rad.")
    free_length_m: float = option(0.0, "Length of the spring without load, m, 0 or more.", low=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arms_m is not None and (len(self.arms_m) != 2 or min(self.arms_m) <= 0 or len(set(self.arms_m)) == 1):
            raise OptionError("gravity_spring needs arms_m of two different distances above 0.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on joint 2, where balancers are, unless joints are named."""
        usual = (min(1, robot.n_joints - 1),)
        return (self if self.joints is not None else replace(self, joints=usual)).revolute(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitude w per joint; with unknown pins the amplitudes a then b of sine and cosine. All rad."""
        sigma, wide = math.radians(0.1), math.radians(1.0)
        if self.arms_m is not None:
            return self.per_joint(robot, "gravity_spring", "rad", sigma, 0.0, wide, "amplitude w = c k a b")
        return tuple(
            p
            for wave in ("sin", "cos")
            for p in self.per_joint(
                robot, f"gravity_spring_{wave}", "rad", sigma, -wide, wide, f"amplitude of {wave} q"
            )
        )

    def signals(self, q: Floats) -> Sequence[Floats]:
        """The pull of the spring; sine and cosine where its pins are unknown."""
        if self.arms_m is None:
            return np.sin(q), np.cos(q)
        a, b = self.arms_m
        angle = q + self.angle_rad
        length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(angle))
        return (-np.sin(angle) * (1.0 - self.free_length_m / length),)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add the pull of the spring, a wave where its pins are unknown."""
        joints = self.acting(len(form.joints))
        if self.arms_m is None:
            form.waves(joints, values, [(1.0,)] * len(joints))
            return
        for j, value in zip(joints, values.tolist(), strict=True):
            constants = (*self.arms_m, self.angle_rad, self.free_length_m)
            form.curve(j, Shape.SPRING, value, constants=constants)
