"""What a simulated joint may lack between its command and its reading: each effect with its numbers and its physical class.

Command and effort delays: Siciliano et al. 2009; load-dependent friction: Bittencourt and Gunnarsson 2012; breakaway:
Armstrong-Hélouvry 1991; backlash and soft gears lie between motor and bodies.
"""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.effects.physical import PhysicalClass
from kilter_core.motion.effects import LOAD, JointEffect
from kilter_core.motion.kernels import joint as place


@dataclass(frozen=True)
class Number:
    """A number of a joint: its ``place`` in the kernel, its unit, the values that physics allows, and values to start from.

    Starts are in multiples of the joint's own ``scale``: ``s`` (1), ``rad`` (1), ``torque`` (its usual torque), ``share`` (1),
    ``rad/torque`` (a radian under its usual torque). A derivative is taken over ``difference`` at least: readings
    bend as backlash opens a step earlier, and over less a fit stops at such a bend.
    """

    name: str
    place: int
    unit: str
    scale: str
    starts: tuple[float, ...]
    low: float = 0.0
    high: float = float("inf")
    difference: float = 0.0


@dataclass(frozen=True)
class RolloutEffect(JointEffect):
    """An effect of one joint: ``number`` is fitted, ``settings`` are places that its variant sets; ``least`` is worth a name.

    ``beside`` are numbers that the effect has too and nobody asks for; ``element`` says what a simulator needs for it.
    """

    number: Number
    least: float
    variants: tuple[dict[int, float], ...] = ({},)
    beside: tuple[Number, ...] = ()
    element: str = ""
    remedy: str = ""


DELAY = PhysicalClass("delay", "delay of {joint}", ("bus", "control loop", "logger's clock"))
PLAY = PhysicalClass("gear_backlash", "backlash of the gear of {joint}", ("gear", "spline", "horn of the servo"))
SOFT = PhysicalClass("gear_twist", "twist of the gear of {joint}", ("belt", "harmonic drive", "soft link"))
BREAKAWAY = PhysicalClass("breakaway", "stick of {joint} at rest", ("seal", "grease", "dead band of the servo"))
LIMIT = PhysicalClass("torque_limit", "torque limit of {joint}", ("current limit", "supply voltage"))
ZERO = PhysicalClass("zero", "zero of {joint}", ("horn set one tooth off", "offset of the logger"))

# which side of the gear the servo closes its loop on, and which is read
SIDES = tuple({place.BEHIND: servo, place.READS_BEHIND: read} for servo, read in ((0.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
ROLLOUT_EFFECTS = (
    RolloutEffect(
        "command_delay",
        "delay of the command",
        DELAY,
        Number("delay", place.COMMAND_DELAY, "s", "s", (0.01, 0.03, 0.06, 0.12), -0.05, 0.3),
        1e-3,
        element="delay",
        remedy="the times at which the controller took each command",
    ),
    RolloutEffect(
        "effort_delay",
        "delay of the torque",
        DELAY,
        Number("delay", place.EFFORT_DELAY, "s", "s", (0.005, 0.015, 0.04), 0.0, 0.1),
        1e-3,
        element="step",
        remedy="the current of the motor beside its command",
    ),
    RolloutEffect(
        "sensor_lag",
        "lag of the sensor",
        DELAY,
        Number("time_constant", place.SENSOR_LAG, "s", "s", (0.01, 0.03, 0.08), 0.0, 0.5),
        1e-3,
        element="reading",
        remedy="a motion with sharp reversals",
    ),
    RolloutEffect(
        "torque_limit",
        "limit of the torque",
        LIMIT,
        Number("limit", place.TORQUE_LIMIT, "N m", "torque", (0.7, 1.2, 2.0, 3.5, 6.0), 1e-6),
        0.0,
        element="forcerange",
        remedy="a fast motion under a larger load",
    ),
    RolloutEffect(
        "backlash",
        "backlash between motor and bodies",
        PLAY,
        Number("width", place.BACKLASH, "rad", "rad", (0.005, 0.015, 0.03), 0.0, 0.2, 1.5e-4),
        1e-3,
        SIDES,
        element="second joint",
        remedy="a motion in which the load changes its sign",
    ),
    RolloutEffect(
        "load_friction",
        "friction by load",
        LOAD,
        Number("share", place.LOAD_FRICTION, "1", "share", (0.04, 0.12, 0.3), 0.0, 1.5),
        0.01,
        ({place.MOVING_LOAD: 1.0}, {place.MOVING_LOAD: 0.0}),  # of all that the gear passes on, or of the weight alone
        element="step",
        remedy="the same motion with two payloads",
    ),
    RolloutEffect(
        "stick",
        "breakaway friction",
        BREAKAWAY,
        Number("breakaway", place.STICK, "N m", "torque", (0.05, 0.15, 0.4)),
        0.0,
        element="step",
        remedy="a slow motion with many reversals",
    ),
    RolloutEffect(
        "flexible_gear",
        "flexible gear",
        SOFT,
        Number("compliance", place.COMPLIANCE, "rad/(N m)", "rad/torque", (0.003, 0.01, 0.03)),
        0.0,
        SIDES,
        (Number("gear_damping", place.GEAR_DAMPING, "s", "log", (0.002,)),),  # over its stiffness
        element="second joint",
        remedy="a fast motion with a larger payload",
    ),
    RolloutEffect(
        "reading_offset",
        "offset of the reading",
        ZERO,
        Number("offset", place.READING_OFFSET, "rad", "rad", (0.01, -0.01), -0.5, 0.5),
        1e-3,
        element="reading",
        remedy="the joint at a mark that is measured",
    ),
    RolloutEffect(
        "zero_offset",
        "offset of the zero",
        ZERO,
        Number("offset", place.ZERO_OFFSET, "rad", "rad", (0.05, -0.05, 0.2, -0.2), -0.8, 0.8),
        5e-3,
        element="ref",
        remedy="the joint at a mark that is measured",
    ),
)
BY_ID = {effect.id: effect for effect in ROLLOUT_EFFECTS}
