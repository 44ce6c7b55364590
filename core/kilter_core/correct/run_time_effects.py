"""Which effects the correction kernel can make up for, and how each one is written into its program.

An effect that is missing here, or that needs what the stream does not know, is named as unsupported when a version is
activated: its share of the error stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from kilter_core.arm.loads.slopes import EACH, weighed, with_masses, with_payload
from kilter_core.arm.robot import Robot
from kilter_core.correct.kernels import layout
from kilter_core.effects import Effect
from kilter_core.effects.axial_compliance import AxialCompliance
from kilter_core.effects.backlash import Backlash
from kilter_core.effects.backlash_load import BacklashLoad
from kilter_core.effects.base_compliance import BaseCompliance
from kilter_core.effects.clearance_tilt import ClearanceTilt
from kilter_core.effects.column_bending import ColumnBending
from kilter_core.effects.direction_compliance import DirectionCompliance
from kilter_core.effects.eccentricity import Eccentricity
from kilter_core.effects.encoder_scale import EncoderScale
from kilter_core.effects.friction_windup import FrictionWindup
from kilter_core.effects.gear_error import GearError
from kilter_core.effects.gravity_spring import GravitySpring
from kilter_core.effects.hardening import Hardening
from kilter_core.effects.joint_coupling import JointCoupling
from kilter_core.effects.link_bending import LinkBending, bent
from kilter_core.effects.link_growth import LinkGrowth
from kilter_core.effects.load_error import LoadError
from kilter_core.effects.payload_error import PayloadError
from kilter_core.effects.radial_compliance import RadialCompliance
from kilter_core.effects.reading_tilt import ReadingTilt
from kilter_core.effects.second_harmonic import SecondHarmonic
from kilter_core.effects.thermal_growth import ThermalGrowth
from kilter_core.effects.tool_sag import ToolSag, sagging
from kilter_core.effects.tracking_lag import TrackingLag
from kilter_core.effects.unknown_joint_curve import UnknownJointCurve
from kilter_core.effects.unknown_smooth_curve import UnknownSmoothCurve
from kilter_core.effects.zero_thermal import ZeroThermal
from kilter_core.model import RobotModel
from kilter_core.types import Floats


@dataclass(frozen=True)
class Conditions:
    """What the stream knows besides the joints; ``temperature_c`` None when nobody states it."""

    least_softening_nm: float = 0.0
    payload_kg: float = 0.0
    temperature_c: float | None = None


@dataclass
class Written:
    """Rows of the program that the effects fill: joints (n, COLUMNS) and what is appended after them."""

    robot: Robot
    conditions: Conditions
    joints: Floats
    curves: list[Floats] = field(default_factory=list)
    beams: list[Floats] = field(default_factory=list)
    pedestal: tuple[float, float] | None = None
    foot: Floats = field(default_factory=lambda: np.zeros(3))  # shift of the base frame, m
    lean: Floats = field(default_factory=lambda: np.zeros(3))  # turn of the base frame, rad

    def curve(self, joint: int, shape: float, a: float, b: float = 0.0, **columns: float) -> None:
        """Add a curve of ``joint``; columns by their name in the kernel, the driver being the joint itself."""
        row = np.zeros(layout.COLUMNS)
        row[layout.CURVED], row[layout.SHAPE] = joint, shape
        row[layout.DRIVER] = columns.get("driver", joint)
        row[layout.AMPLITUDE_A], row[layout.AMPLITUDE_B] = a, b
        row[layout.FACTOR] = columns.get("factor", 1.0)
        if a != 0.0 or b != 0.0:
            self.curves.append(row)

    def beam(self, joint: int, of_joint: Floats, of_end: Floats, link: Floats) -> None:
        """Add the twist of ``joint`` by matrices (6, 6) of the wrench on it, and of that on the end of its ``link (3,)``.

        The kernel moves the wrench to the end of the link: once for each row with a link, so give none where no moment
        at the end counts.
        """
        rows = np.zeros((2, layout.COLUMNS))
        rows[0, :36], rows[1, :36] = of_joint.ravel(), of_end.ravel()
        rows[0, layout.BENDING_JOINT] = joint
        rows[0, layout.BENDING_LINK : layout.BENDING_LINK + 3] = link
        self.beams.extend(rows)
        self.joints[joint, layout.TWISTED] = 1.0

    def free(self, column: int, joints: tuple[int, ...]) -> bool:
        """Whether a column that holds one effect only is still empty at these joints."""
        return not np.any(self.joints[list(joints), column])


_Writer = Callable[[Written, Any, Floats], bool]


def write_effect(written: Written, effect: Effect, values: Floats) -> bool:
    """Write an effect with its values; False when the kernel cannot make up for it."""
    writer = _WRITERS.get(effect.id)
    return writer is not None and writer(written, effect, values)


def _pairs(written: Written, effect: Effect, values: Floats) -> list[tuple[int, float]]:
    return list(zip(effect.acting(written.robot.n_joints), values.tolist(), strict=True))


def _softening(written: Written, effect: ClearanceTilt | BacklashLoad) -> dict[int, float]:
    """Half-width of the sign at each joint: one of the effect's own, and at least what the stream asks for."""
    joints = effect.acting(written.robot.n_joints)
    own = effect.softening_nm
    widths = own if isinstance(own, tuple) else (own,) * len(joints)
    least = written.conditions.least_softening_nm
    return {j: max(width, least) for j, width in zip(joints, widths, strict=True)}


def _tilt(written: Written, effect: ClearanceTilt, values: Floats) -> bool:
    if not written.free(layout.TILT, effect.acting(written.robot.n_joints)):
        return False
    widths = _softening(written, effect)
    for j, value in _pairs(written, effect, values):
        row = written.joints[j]
        row[layout.TILT] = math.tan(value)
        row[layout.TILT_SHARE] = 0.0 if effect.share == "thesis" else 1.0
        row[layout.TILT_SOFT] = widths[j]
    return True


def _play(written: Written, effect: BacklashLoad, values: Floats) -> bool:
    if not written.free(layout.PLAY, effect.acting(written.robot.n_joints)):
        return False
    widths = _softening(written, effect)
    for j, value in _pairs(written, effect, values):
        written.joints[j, layout.PLAY] = value
        written.joints[j, layout.PLAY_SOFT] = widths[j]
    return True


def _adds(column: int, factor: float = 1.0) -> _Writer:
    """Write values that add to a column of their joint."""

    def write(written: Written, effect: Effect, values: Floats) -> bool:
        for j, value in _pairs(written, effect, values):
            written.joints[j, column] += factor * value
        return True

    return write


def _waves(written: Written, effect: Effect, values: Floats, factors: Mapping[int, list[float]]) -> None:
    """Sines then cosines per joint, factor by factor, as :meth:`Effect.joint_angle` orders them."""
    acting = effect.acting(written.robot.n_joints)
    count = len(acting)
    for place, j in enumerate(acting):
        for order, factor in enumerate(factors[j]):
            start = 2 * order * count + place
            written.curve(j, layout.WAVE, float(values[start]), float(values[start + count]), factor=factor)


def _harmonic(factor: float) -> _Writer:
    def write(written: Written, effect: Effect, values: Floats) -> bool:
        _waves(written, effect, values, {j: [factor] for j in effect.acting(written.robot.n_joints)})
        return True

    return write


def _gear(written: Written, effect: GearError, values: Floats) -> bool:
    ratios = zip(effect.acting(written.robot.n_joints), effect.ratios or (), strict=True)
    _waves(written, effect, values, {j: [order * ratio for order in effect.orders] for j, ratio in ratios})
    return True


def _joint_curve(written: Written, effect: UnknownJointCurve, values: Floats) -> bool:
    acting = effect.acting(written.robot.n_joints)
    _waves(written, effect, values, {j: [float(m) for m in effect.orders] for j in acting})
    if effect.partner is not None:
        for j, value in zip(acting, values[len(values) - len(acting) :].tolist(), strict=True):
            written.curve(j, layout.SINES, value, driver=effect.partner)
    return True


def _smooth(written: Written, effect: UnknownSmoothCurve, values: Floats) -> bool:
    acting = effect.acting(written.robot.n_joints)
    ranges = zip(acting, effect.centres or (), effect.halves or (), strict=True)
    for place, (j, centre, half) in enumerate(ranges):
        series = np.zeros(layout.HIGHEST - layout.POWERS + 1)
        series[list(effect.orders)] = values[place :: len(acting)]
        written.curve(j, layout.POLYNOMIAL, 1.0)
        powers = legendre.leg2poly(series)
        row = written.curves[-1]
        row[layout.EXTRA : layout.EXTRA + 2] = centre, half
        row[layout.POWERS : layout.POWERS + len(powers)] = powers
    return True


def _spring(written: Written, effect: GravitySpring, values: Floats) -> bool:
    if effect.arms_m is None:
        return _harmonic(1.0)(written, effect, values)
    for j, value in _pairs(written, effect, values):
        written.curve(j, layout.SPRING, value)
        if value != 0.0:
            extra = (*effect.arms_m, effect.angle_rad, effect.free_length_m)
            written.curves[-1][layout.EXTRA : layout.EXTRA + 4] = extra
    return True


def _scale(written: Written, effect: EncoderScale, values: Floats) -> bool:
    for j, value in _pairs(written, effect, values):
        written.curve(j, layout.LINEAR, value)
    return True


def _coupling(written: Written, effect: JointCoupling, values: Floats) -> bool:
    for (j, value), driver in zip(_pairs(written, effect, values), effect.drivers or (), strict=True):
        written.curve(j, layout.LINEAR, value, driver=driver)
    return True


def _lag(written: Written, effect: TrackingLag, values: Floats) -> bool:
    for j, value in _pairs(written, effect, values):
        written.curve(j, layout.LAG, value)
    return True


def _bending(written: Written, effect: LinkBending, values: Floats) -> bool:
    """A link's twist is linear in the wrenches on its joint and on its end: two matrices hold all of it."""
    robot = written.robot
    if any(e.joint is not None and k not in robot.chain.primary for k, e in enumerate(robot.chain.elements)):
        return False  # the end of a link is then not at a constant place
    none, unit = np.zeros((6, 6)), np.eye(6)
    for (j, value), centre in zip(_pairs(written, effect, values), effect.centres_m or (), strict=True):
        link = robot.chain.link_vectors[j]
        written.beam(j, value * bent(link, centre, unit, none).T, value * bent(link, centre, none, unit).T, link)
    return True


def _pedestal(written: Written, effect: BaseCompliance, values: Floats) -> bool:
    x, y = written.pedestal or (0.0, 0.0)
    written.pedestal = (x + float(values[0]), y + float(values[1]))
    return True


def _growth(written: Written, effect: ThermalGrowth, values: Floats) -> bool:
    if written.conditions.temperature_c is None:
        return False
    grown = (
        float(values[0]) * (written.conditions.temperature_c - effect.reference_c) * written.robot.chain.link_vectors
    )
    written.joints[:, layout.XI : layout.XI + 3] += grown[:-1]
    written.joints[:, layout.TWISTED] = 1.0
    written.foot += grown[-1]
    return True


def _link_growth(written: Written, effect: LinkGrowth, values: Floats) -> bool:
    if written.conditions.temperature_c is None:
        return False
    warmer = written.conditions.temperature_c - effect.reference_c
    for j, value in _pairs(written, effect, values):
        written.joints[j, layout.XI : layout.XI + 3] += value * warmer * written.robot.chain.link_vectors[j]
        written.joints[j, layout.TWISTED] = 1.0
    return True


def _zeros(written: Written, effect: ZeroThermal, values: Floats) -> bool:
    if written.conditions.temperature_c is None:
        return False
    for j, value in _pairs(written, effect, values):
        written.joints[j, layout.DQ] += value * (written.conditions.temperature_c - effect.reference_c)
    return True


def _column(written: Written, effect: ColumnBending, values: Floats) -> bool:
    if written.conditions.temperature_c is None:
        return False
    written.lean[:2] += values * (written.conditions.temperature_c - effect.reference_c)
    return True


def _reading(written: Written, effect: ReadingTilt, values: Floats) -> bool:
    """What a load across the axis adds to the joint: a twist along or about z, linear in the wrench on the joint."""
    acting = effect.acting(written.robot.n_joints)
    for place, j in enumerate(acting):
        turns = np.zeros((6, 6))
        turns[5 if written.robot.joints[j].kind == "revolute" else 2, 3:5] = values[place :: len(acting)]
        written.beam(j, turns, np.zeros((6, 6)), np.zeros(3))
    return True


def _sag(written: Written, effect: ToolSag, values: Floats) -> bool:
    if written.conditions.payload_kg == 0.0:
        return True  # nothing hangs on the tool
    moved = np.zeros((6, 6))
    moved[:3, :3] = float(values[0]) * sagging(effect.axis or (0.0, 0.0, 1.0)).T
    written.beam(written.robot.n_joints - 1, np.zeros((6, 6)), moved, np.zeros(3))
    return True


def _payload(written: Written, effect: PayloadError, values: Floats) -> bool:
    # Without compliances the payload of the program is written with it; with them it acts in rows that carry one.
    return not effect.compliances or written.conditions.payload_kg == 0.0


def _masses(written: Written, effect: LoadError, values: Floats) -> bool:
    return True  # the bodies of the program are written with them


def weighed_anew(
    model: RobotModel, values: Floats, payload_kg: float, payload_com: Sequence[float]
) -> tuple[Robot, tuple[float, Sequence[float]]]:
    """The robot that loads are computed from with the masses that its load errors leave; mass and place of the payload."""
    robot, carried = model.load_robot, np.zeros(EACH)
    for effect, where in zip(model.effects, model.effect_slices().values(), strict=True):
        if isinstance(effect, LoadError):
            own, split = values[where], EACH * len(weighed(robot))
            robot = with_masses(robot, own[:split].tolist())
            carried[: len(own) - split] += own[split:]
        elif isinstance(effect, PayloadError) and not effect.compliances:
            carried += values[where]
    return robot, with_payload(payload_kg, payload_com, carried.tolist())


_WRITERS: Mapping[str, _Writer] = {
    ClearanceTilt.id: _tilt,
    BacklashLoad.id: _play,
    Backlash.id: _adds(layout.REVERSAL),
    FrictionWindup.id: _adds(layout.REVERSAL, 2.0),  # its k is half a backlash
    AxialCompliance.id: _adds(layout.COMPLIANCE),
    RadialCompliance.id: _adds(layout.RADIAL),
    Eccentricity.id: _harmonic(1.0),
    SecondHarmonic.id: _harmonic(2.0),
    GearError.id: _gear,
    UnknownJointCurve.id: _joint_curve,
    UnknownSmoothCurve.id: _smooth,
    GravitySpring.id: _spring,
    EncoderScale.id: _scale,
    JointCoupling.id: _coupling,
    TrackingLag.id: _lag,
    LinkBending.id: _bending,
    BaseCompliance.id: _pedestal,
    ThermalGrowth.id: _growth,
    PayloadError.id: _payload,
    ZeroThermal.id: _zeros,
    LinkGrowth.id: _link_growth,
    ColumnBending.id: _column,
    ToolSag.id: _sag,
    Hardening.id: _adds(layout.HARDENING),
    DirectionCompliance.id: _adds(layout.SIDED),
    ReadingTilt.id: _reading,
    LoadError.id: _masses,
}
