"""Physical classes: what acts at the same place in the same way, members of the library or not.

A shape that repeats does not prove a cause: within a class a member is named only by evidence that separates it from the
others. Every effect states its class and that evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class PhysicalClass:
    """A class: its ``id``, its ``label`` with {joint} for the joints, and in words the ``outside`` members of no library.

    ``shaped`` says whether the shape that a member gives it tells anything more; ``went`` is added where what it follows
    may have gone along with something else. ``clock`` is that of a class of whatever follows it, wherever it acts.
    """

    id: str
    label: str
    outside: tuple[str, ...] = ()
    shaped: bool = True
    went: str = ""
    clock: str = ""

    def label_for_joints(self, joints: Sequence[int] | None) -> str:
        """Label at joints (from 0)."""
        return self.label.format(joint=joint_numbers(joints) if joints else "the arm")


def joint_numbers(joints: Sequence[int]) -> str:
    """Joints (from 0) as people count them: "joint 2", "joints 2, 3"."""
    return f"joint{'s' if len(joints) > 1 else ''} {', '.join(str(j + 1) for j in joints)}"


class Separator(Enum):
    """Evidence that separates a member from the others of its class; the value says it in words."""

    TURN = "more than one turn of the joint"
    LOADS = "its dependence on the load, at two loads"
    TEMPERATURE = "a temperature that does not go along with time"
    ORDER = "poses revisited at other times, or a random order, so that nothing else goes along with time"
    FRICTION = "friction from torques times compliance from loads"
    SENSOR = "a sensor at the place itself: a link encoder, an inclinometer or a reflector on the base"


WENT = ", or with whatever went with it"

JOINT_TWIST = PhysicalClass(
    "joint_twist", "twist about the axis of {joint} under load", ("gear", "harmonic drive", "bearing", "coupling")
)
LINK_TWIST = PhysicalClass(JOINT_TWIST.id, "twist of the link after {joint} under load", JOINT_TWIST.outside)
JOINT_CURVE = PhysicalClass("joint_curve", "error curve of {joint}", ("belt", "hose", "cable", "worn gear"))
# Nearly a straight line: any smooth curve of little bend, so the shape says nothing.
SMOOTH_CURVE = PhysicalClass(JOINT_CURVE.id, "smooth error of {joint}", JOINT_CURVE.outside, shaped=False)
JOINT_SCALE = PhysicalClass(
    "joint_scale", "scale of {joint}", ("pitch of the screw or belt", "thermal length of the scale")
)
JOINT_FOLLOWS = PhysicalClass(
    "joint_coupling", "error of {joint} that follows another joint", ("hose or cable across both joints", "shared belt")
)
REVERSAL = PhysicalClass(
    "reversal", "reversal error of {joint}", ("hysteresis of the gear", "presliding of a bearing", "drag of a cable")
)
JOINT_TILT = PhysicalClass("joint_tilt", "tilt of {joint} under load", ("bearing", "flange", "mount of the base"))
BASE_TILT = PhysicalClass(JOINT_TILT.id, "tilt of the base or of joint 1 under load", JOINT_TILT.outside)
LINK_SAG = PhysicalClass("load_sag", "sag of the link after {joint} under load", ("flange", "telescope", "weld"))
TELESCOPE_SAG = PhysicalClass(
    LINK_SAG.id, "sag under load of the arm that {joint} extends", ("clearance of the guide", "bearing of the carriage")
)
TOOL_SAG = PhysicalClass(LINK_SAG.id, "sag of the tool under load", ("adapter", "gripper", "flange"))
GUIDE = PhysicalClass(
    "guide", "error of the guide of {joint}", ("bent or sagging rail", "worn carriage", "hose that pulls the carriage")
)
LOADS = PhysicalClass("loads", "loads that are not as stated", ("weight of hoses", "forgotten adapter", "other masses"))
# That something went with a clock, and not where: a scale about the station is a drift of the base beside a growth.
STATION = PhysicalClass(
    "station",
    "motion with time of base, station, air or arm",
    ("knocked tripod or base", "floor", "temperature", "link that bends"),
    went=WENT,
    clock="t",
)
LINK_LENGTH = PhysicalClass(STATION.id, STATION.label, ("motor that warms the link", "sun"), went=WENT, clock="t")
READ_STATION = PhysicalClass(
    STATION.id, "motion of the base that its inclinometer reads", ("soft column or floor", "loose anchor")
)
JOINT_ZERO = PhysicalClass(
    "joint_zero",
    "zero of {joint}, or a link beside it, that moved with time or temperature",
    ("knocked joint", "slipping coupling", "bending mount", "sun on one side of a link"),
    went=WENT,
)
THERMAL = PhysicalClass(
    "thermal",
    "motion with temperature of base, station, air or arm",
    ("sun on one side", "warm motor", "bending column or mount"),
    clock="temperature_c",
)
OF_CLOCK = {one.clock: one for one in (STATION, THERMAL)}
TOOL_SHIFT = PhysicalClass(
    "tool", "shift of tool or marker between sessions", ("remounted marker", "bumped tool"), went=WENT
)
INSTRUMENT = PhysicalClass("instrument", "error of the instrument", ("refraction", "its own calibration"))
DELAY = PhysicalClass("delay", "delay between readings and positions", ("filter", "buffer", "clock"))
SHAPE = PhysicalClass("shape", "shape without a cause")
