"""What torques may hold beside rigid bodies: each effect with its column, its unit and its physical class.

Friction by speed: Armstrong-Hélouvry 1991; by load and temperature: Bittencourt and Gunnarsson 2012; gain and delay of
the drive: Gautier and Briot 2014. A column is what one unit of the parameter adds to the measured torque of the joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.effects.physical import PhysicalClass
from kilter_core.types import Floats

FADE_SHARE = 0.1  # of the joint's usual highest speed, at which the friction of breaking loose has faded
SIGN_SHARE = 0.005  # of it, over which the sign of the speed changes
LEAST_SPEED = 1e-9


@dataclass(frozen=True)
class JointSignals:
    """A joint in a stretch of a log, rows (N,): angle, speed and acceleration, rad or m; the torque ``load`` of its bodies
    and of the whole ``model`` so far, N m, and of a model ``in_time`` that knows no delay; ``t`` s and ``temperature_c``
    as differences from the log's mean.

    ``usual_speed`` is the highest it usually reaches; ``middle`` of its range, ``order`` per turn at which it ripples,
    ``delay_s`` by which its torque looks late, ``fade`` the speed at which the friction of breaking loose looks faded.
    """

    q: Floats
    qd: Floats
    qdd: Floats
    load: Floats
    model: Floats
    in_time: Floats
    t: Floats
    temperature: Floats
    usual_speed: float
    middle: float
    order: float | None
    delay_s: float
    fade: float

    @property
    def fading_column(self) -> Floats:
        """The friction of breaking loose of one newton metre."""
        return np.asarray(self.sign * np.exp(-((self.qd / self.fade) ** 2)))

    @property
    def delay_column(self) -> Floats:
        """What a delay of one second adds: the secant between the model and the model as late as it looks."""
        return (np.interp(self.t - self.delay_s, self.t, self.in_time) - self.in_time) / self.delay_s

    @property
    def sign(self) -> Floats:
        """The sign of the speed, smooth where it changes."""
        return np.tanh(self.qd / max(SIGN_SHARE * self.usual_speed, LEAST_SPEED))


@dataclass(frozen=True)
class JointEffect:
    """An effect on one joint, of its torque or of its servo."""

    id: str
    label: str
    physical: PhysicalClass

    def describe_class(self, label: str, effects: Sequence[JointEffect]) -> dict[str, Any]:
        """Return its physical class under this label; ``effects`` are all that a search tries."""
        members = [other.id for other in effects if other.physical.id == self.physical.id]
        return {"id": self.physical.id, "label": label, "members": members, "outside": list(self.physical.outside)}


@dataclass(frozen=True)
class MotionEffect(JointEffect):
    """An effect on the torque of one joint; ``columns`` are (N, k) for ``parameters`` with their units (angles in rad).

    ``common`` ones belong to every model and are fitted, not searched. ``within`` are the values that
    physics allows. It may need the ``temperature``, or the ``order`` of a ripple. Where it ``follows_model``, its columns
    are computed anew from the model that has it. What follows the clock of a log is not told ``ahead`` of a motion.
    """

    parameters: tuple[tuple[str, str], ...]
    columns: Callable[[JointSignals], Floats]
    common: bool = False
    within: tuple[float, float] = (-np.inf, np.inf)
    needs: frozenset[str] = frozenset()
    remedy: str = ""
    follows_model: bool = False
    ahead: bool = True


def _single_column(column: Callable[[JointSignals], Floats]) -> Callable[[JointSignals], Floats]:
    return lambda signals: column(signals)[:, None]


OFFSET = PhysicalClass("torque_offset", "constant torque of {joint}", ("bias of the sensor", "pull of a hose"))
SPEED = PhysicalClass("friction_by_speed", "friction of {joint} that follows its speed", ("grease", "seal", "bearing"))
SIDE = PhysicalClass(
    "friction_by_side", "friction of {joint} that differs between directions", ("preload", "worn flank")
)
LOAD = PhysicalClass("friction_by_load", "friction of {joint} that follows its load", ("gear", "bearing"))
INERTIA = PhysicalClass("drive_inertia", "inertia of the drive of {joint}", ("rotor", "brake", "inertia of the link"))
SCALE = PhysicalClass("torque_scale", "scale of the torque of {joint}", ("torque constant", "gear ratio", "masses"))
TIME_SHIFT = PhysicalClass("torque_delay", "delay between position and torque of {joint}", ("logger", "current loop"))
PERIOD = PhysicalClass(
    "torque_ripple", "torque of {joint} that repeats with its angle", ("teeth", "magnets", "wave gear")
)
POSITION = PhysicalClass(
    "torque_by_position", "torque of {joint} that follows its angle", ("hose", "spring", "balancer")
)
WARMTH = PhysicalClass("friction_by_time", "friction of {joint} that changed with time", ("temperature", "running in"))
DRIFT = PhysicalClass("torque_drift", "torque of {joint} that drifted", ("bias of the sensor", "temperature"))
CARRIED = PhysicalClass(
    "carried_mass", "mass on the link of {joint} that differs between sessions", ("payload", "tool", "fixture")
)

MOTION_EFFECTS: tuple[MotionEffect, ...] = (
    MotionEffect(
        "torque_offset",
        "offset",
        OFFSET,
        (("offset", "N m"),),
        _single_column(lambda s: np.ones_like(s.q)),
        common=True,
    ),
    MotionEffect(
        "coulomb", "Coulomb friction", SPEED, (("friction", "N m"),), _single_column(lambda s: s.sign), common=True
    ),
    MotionEffect(
        "viscous", "viscous friction", SPEED, (("damping", "N m s/rad"),), _single_column(lambda s: s.qd), common=True
    ),
    MotionEffect(
        "stribeck",
        "friction of breaking loose (Stribeck)",
        SPEED,
        (("friction", "N m"),),
        _single_column(lambda s: s.fading_column),
        remedy="slow motions, below a tenth of the usual speed, in both directions",
    ),
    MotionEffect(
        "root_speed",
        "friction that grows with the root of the speed",
        SPEED,
        (("friction", "N m (s/rad)^0.5"),),
        _single_column(lambda s: s.sign * np.sqrt(np.abs(s.qd))),
        remedy="motions at constant speeds from slow to fast",
    ),
    MotionEffect(
        "quadratic_speed",
        "friction that grows with the square of the speed",
        SPEED,
        (("friction", "N m s2/rad2"),),
        _single_column(lambda s: s.qd * np.abs(s.qd)),
        remedy="motions at constant speeds from slow to fast",
    ),
    MotionEffect(
        "one_sided_damping",
        "viscous friction that differs between the directions",
        SIDE,
        (("damping", "N m s/rad"),),
        _single_column(lambda s: np.abs(s.qd)),
        remedy="the same path in both directions at several speeds",
    ),
    MotionEffect(
        "load_friction",
        "friction that grows with the load",
        LOAD,
        (("share", "1"),),
        _single_column(lambda s: np.abs(s.load) * s.sign),
        within=(0.0, 0.5),
        follows_model=True,
        remedy="the same slow motion with the arm stretched and folded, or with and without a payload",
    ),
    MotionEffect(
        "motor_inertia",
        "inertia of the motor",
        INERTIA,
        (("inertia", "kg m2"),),
        _single_column(lambda s: s.qdd),
        within=(0.0, np.inf),
        remedy="fast reversals of this joint while the joints beyond it are stretched and folded",
    ),
    MotionEffect(
        "drive_gain",
        "gain of the drive",
        SCALE,
        (("share", "1"),),
        _single_column(lambda s: s.model),
        within=(-0.7, 2.0),
        follows_model=True,
        remedy="the same motion with a known weight on the flange",
    ),
    MotionEffect(
        "torque_delay",
        "delay of the torque",
        TIME_SHIFT,
        (("delay", "s"),),
        _single_column(lambda s: s.delay_column),
        within=(-0.25, 0.25),
        follows_model=True,
        remedy="fast reversals, and both signals on one clock",
        ahead=False,
    ),
    MotionEffect(
        "gear_ripple",
        "ripple of the gear",
        PERIOD,
        (("sine", "N m"), ("cosine", "N m")),
        lambda s: np.stack([np.sin((s.order or 0.0) * s.q), np.cos((s.order or 0.0) * s.q)], axis=1),
        needs=frozenset({"order"}),
        remedy="slow motion over many teeth, at two speeds",
    ),
    MotionEffect(
        "spring",
        "spring about the joint",
        POSITION,
        (("stiffness", "N m/rad"),),
        _single_column(lambda s: s.q - s.middle),
        remedy="the whole range of this joint while gravity on it changes otherwise",
    ),
    MotionEffect(
        "counterbalance",
        "counterbalance",
        POSITION,
        (("sine", "N m"), ("cosine", "N m")),
        lambda s: np.stack([np.sin(s.q), np.cos(s.q)], axis=1),
        remedy="the whole range of this joint while the joints beyond it change the load",
    ),
    MotionEffect(
        "cable_curve",
        "pull of a cable",
        POSITION,
        (("square", "N m/rad2"), ("cube", "N m/rad3")),
        lambda s: np.stack([(s.q - s.middle) ** 2, (s.q - s.middle) ** 3], axis=1),
        remedy="the whole range of this joint, slowly",
    ),
    MotionEffect(
        "warm_up",
        "viscous friction that changes while it runs",
        WARMTH,
        (("change", "N m/rad"),),
        _single_column(lambda s: s.qd * s.t),
        remedy="a log of half an hour from cold, with the temperature of the joint",
        ahead=False,
    ),
    MotionEffect(
        "thermal_friction",
        "viscous friction that follows the temperature",
        WARMTH,
        (("change", "N m s/(rad K)"),),
        _single_column(lambda s: s.qd * s.temperature),
        needs=frozenset({"temperature"}),
        remedy="a log from cold and one when warm, with temperature_c",
    ),
    MotionEffect(
        "offset_drift",
        "offset that drifts",
        DRIFT,
        (("drift", "N m/s"),),
        _single_column(lambda s: s.t),
        remedy="the same motion at the start and at the end",
        ahead=False,
    ),
)

Wanted = Mapping[str, frozenset[int] | None]  # joints (from 0) by id of an effect; None: all


def split_effects(asked: Sequence[str | Mapping[str, Any]]) -> tuple[Wanted, list[str | Mapping[str, Any]]]:
    """Return the effects of torques among those asked for, and the others."""
    known = {effect.id for effect in MOTION_EFFECTS}
    wanted: dict[str, frozenset[int] | None] = {}
    others = []
    for one in asked:
        named: Mapping[str, Any] = {"id": one} if isinstance(one, str) else one
        if named["id"] not in known:
            others.append(one)
            continue
        joints, before = named.get("joints"), wanted.get(named["id"], frozenset())
        wanted[named["id"]] = None if joints is None or before is None else before | {j - 1 for j in joints}
    return wanted, others


INERTIAS = ("xx", "xy", "xz", "yy", "yz", "zz")
# A mass on a link in one session and not in the first. Its columns are those of the link, at all joints: see the layout.
CARRIED_MASS = MotionEffect(
    "carried_mass",
    "mass",
    CARRIED,
    (("mass", "kg"), *((f"moment_{x}", "kg m") for x in "xyz"), *((f"inertia_{x}", "kg m2") for x in INERTIAS)),
    _single_column(lambda s: np.zeros_like(s.q)),
    remedy="the same motions with and without it, and state payload_kg",
    follows_model=True,
)

CARRIED_WITH = ("load_friction",)  # what a load changes beside the bodies


def prismatic_unit(unit: str) -> str:
    """Return the unit that a number of a revolute joint has at a prismatic joint."""
    return unit.replace("N m", "N").replace("rad", "m").replace("kg m2", "kg")
