"""What effects do to an arm while it moves, by name: the form in which an effect hands itself to the correction.

Each effect adds to it in its own file (``Effect.at_run_time``). How the correction stores and computes it is none of an
effect's business. Angles rad, lengths m, loads N and N m, in the joint frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto

import numpy as np

from kilter_core.arm.load_slopes import EACH, links_with_mass
from kilter_core.arm.robot import Robot
from kilter_core.types import Floats


@dataclass(frozen=True)
class Conditions:
    """What is known at run time besides the joints; ``temperature_c`` and ``base_tilt`` rad None when not stated."""

    payload_kg: float = 0.0
    temperature_c: float | None = None
    base_tilt: tuple[float, float] | None = None


@dataclass
class JointForm:
    """What a joint adds to its command, and the twist behind it, at the loads and the direction of motion of now.

    ``offset`` rad or m; ``twist (6,)``; ``tilt`` is the tangent of a tilt of fixed size towards the load across the joint
    (shared by the direction of the load where ``tilt_by_vector``, else by thesis eq. 5.16), and ``backlash`` a shift
    of fixed size to the side of the load about it, both with the half-width of their sign; ``reversal`` the whole width between
    the two directions of motion; then what is proportional to the load: ``compliance`` about the joint,
    ``compliance_by_direction`` times the direction of motion, ``hardening`` times load and size of the load, and
    ``radial_compliance`` across it.
    """

    offset: float = 0.0
    twist: Floats = field(default_factory=lambda: np.zeros(6))
    tilt: float = 0.0
    tilt_by_vector: bool = False
    tilt_softening_nm: float = 0.0
    backlash: float = 0.0
    backlash_softening_nm: float = 0.0
    reversal: float = 0.0
    compliance: float = 0.0
    compliance_by_direction: float = 0.0
    hardening: float = 0.0
    radial_compliance: float = 0.0


class Shape(Enum):
    """Curves of a joint by the angle q of a driving joint, times an amplitude a."""

    WAVE = auto()  # a sin(factor q) + b cos(factor q)
    LINEAR = auto()  # a q
    SPRING = auto()  # -a sin(q + angle) (1 - free length / length), constants: arms, angle, free length
    SINES = auto()  # a sin q times the sine of the joint's own angle
    LAG = auto()  # -a times the speed
    POLYNOMIAL = auto()  # of (q - centre) / half, held at -1 and 1; constants: centre, half


@dataclass(frozen=True)
class Curve:
    """A curve that is added to ``joint``; ``driver`` is the joint that it follows, ``powers`` those of a polynomial.

    Where ``twist`` is a component of the twist behind the joint (0-5), the curve is added to that. ``within`` are the lowest
    and the highest of the driver at which it holds, the way beyond in which it fades, and to what.
    """

    joint: int
    shape: Shape
    driver: int
    a: float
    b: float = 0.0
    factor: float = 1.0
    constants: tuple[float, ...] = ()
    powers: tuple[float, ...] = ()
    twist: int | None = None
    within: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class BendingRow:
    """Twist behind a joint by matrices (6, 6) of the wrench on it, and of that on the end of its ``link (3,)``.

    ``reach`` (power, root, way): all of it times that power of way (q - root), which is 0 where this is below 0; power 0:
    whatever q is. ``of_axis``: the part along or about the joint is a motion of the joint itself, in front of the twist.
    """

    joint: int
    of_joint: Floats
    of_end: Floats
    link: Floats
    reach: tuple[int, float, float] = (0, 0.0, 1.0)
    of_axis: bool = False


@dataclass
class RunTimeForm:
    """All that the effects of a model do at run time.

    ``base_shift`` m and ``base_tilt`` rad, together a twist, move the base frame; ``base_compliance`` rad/(N m) tilts it
    about x and y by the load on it. ``link_errors`` are errors of the masses of the links, four of each that has one,
    ``payload_errors`` four of the payload, in the order of :class:`~kilter_core.arm.load_slopes.LoadSlopes`.
    """

    robot: Robot
    conditions: Conditions
    joints: tuple[JointForm, ...]
    curves: list[Curve] = field(default_factory=list)
    bending: list[BendingRow] = field(default_factory=list)
    twisted: set[int] = field(default_factory=set)
    base_shift: Floats = field(default_factory=lambda: np.zeros(3))
    base_tilt: Floats = field(default_factory=lambda: np.zeros(3))
    base_compliance: tuple[float, float] | None = None
    link_errors: Floats | None = None
    payload_errors: Floats = field(default_factory=lambda: np.zeros(EACH))

    @classmethod
    def empty(cls, robot: Robot, conditions: Conditions) -> RunTimeForm:
        """The form of an arm without effects."""
        return cls(robot, conditions, tuple(JointForm() for _ in robot.joints))

    def free(self, name: str, joints: Sequence[int]) -> bool:
        """Whether a number of which a joint has only one is still open at these joints."""
        return all(getattr(self.joints[j], name) == 0.0 for j in joints)

    def add(self, name: str, joints: Sequence[int], values: Floats) -> None:
        """Add one value to a number of each of these joints."""
        for j, value in zip(joints, values.tolist(), strict=True):
            setattr(self.joints[j], name, getattr(self.joints[j], name) + value)

    def add_side(self, joints: Sequence[int], values: Floats, softening_nm: float | tuple[float, ...]) -> bool:
        """Add a shift to the side of the load about each of these joints; False where another effect has one already."""
        if not self.free("backlash", joints):
            return False
        for j, value, width in zip(joints, values.tolist(), self.softening(softening_nm, joints), strict=True):
            self.joints[j].backlash, self.joints[j].backlash_softening_nm = value, width
        return True

    def twist(self, joint: int, translation: Floats) -> None:
        """Add a constant translation (3,) behind a joint."""
        self.joints[joint].twist[:3] += translation
        self.twisted.add(joint)

    def curve(
        self,
        joint: int,
        shape: Shape,
        a: float,
        b: float = 0.0,
        *,
        driver: int | None = None,
        factor: float = 1.0,
        constants: tuple[float, ...] = (),
        powers: tuple[float, ...] = (),
        twist: int | None = None,
    ) -> None:
        """Add a curve of a joint, or of a component of the twist behind it; it follows the joint unless another drives it."""
        if a != 0.0 or b != 0.0:
            driver = joint if driver is None else driver
            self.curves.append(Curve(joint, shape, driver, a, b, factor, constants, powers, twist))
        if twist is not None:
            self.twisted.add(joint)

    def bound_curves(self, first: int, joint: int, ends: tuple[float, float], fade: float, mean: float) -> None:
        """Let the curves of a joint from the ``first`` on hold between these ends; beyond, they fade to their ``mean``."""
        for k, curve in enumerate(self.curves[first:], first):
            if curve.joint == joint:
                self.curves[k] = replace(curve, within=(*ends, fade, mean))
                mean = 0.0  # of all of them together

    def waves(self, joints: Sequence[int], values: Floats, factors: Sequence[Sequence[float]]) -> None:
        """Add waves of joints, ``factors`` joint by joint; amplitudes of sines then cosines per joint, factor by factor."""
        count = len(joints)
        for place, j in enumerate(joints):
            for order, factor in enumerate(factors[place]):
                start = 2 * order * count + place
                self.curve(j, Shape.WAVE, float(values[start]), float(values[start + count]), factor=factor)

    def bend(
        self,
        joint: int,
        of_joint: Floats,
        of_end: Floats,
        link: Floats,
        reach: tuple[int, float, float] = (0, 0.0, 1.0),
        of_axis: bool = False,
    ) -> None:
        """Add a twist that is linear in the wrenches, see :class:`BendingRow`."""
        self.bending.append(BendingRow(joint, of_joint, of_end, link, reach, of_axis))
        self.twisted.add(joint)

    def softening(self, own: float | tuple[float, ...], joints: Sequence[int]) -> list[float]:
        """Half-width of a sign at each of these joints, of an effect that states one or one for each."""
        widths = own if isinstance(own, tuple) else (own,) * len(joints)
        return [width for _, width in zip(joints, widths, strict=True)]

    def warmer_than(self, reference_c: float) -> float | None:
        """Kelvin above a reference; None when the temperature is not stated."""
        return None if self.conditions.temperature_c is None else self.conditions.temperature_c - reference_c

    def change_masses(self, values: Floats) -> None:
        """Add errors of the links that have a mass and, behind them, of the payload where there are more."""
        split = EACH * len(links_with_mass(self.robot))
        links = np.zeros(split) if self.link_errors is None else self.link_errors
        self.link_errors = links + values[:split]
        self.payload_errors[: len(values) - split] += values[split:]
