"""A robot: its chain, joints, link masses, gravity, and the nominal base and tool frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.parameters import CorrelatedPrior
from kilter_core.types import Floats

STANDARD_GRAVITY = 9.80665  # m/s²
# Uncertainty of masses from drawings and data sheets where none is stated: they lack cables, grease and screws.
MASS_SHARE = 0.1
CENTRE_M = 0.01


@dataclass(frozen=True)
class Joint:
    """A joint: limits in rad (m when prismatic), gear ratio when known.

    ``drive_stiffness`` N m/rad, where it is roughly known, says how soft the drive may be found to be.
    """

    name: str
    kind: str = "revolute"
    lower: float = -math.inf
    upper: float = math.inf
    gear_ratio: float | None = None
    drive_stiffness: float | None = None


@dataclass(frozen=True)
class Link:
    """A rigid link: mass kg, centre of mass m and inertia about it kg·m², in the frame after chain element ``element``.

    A robot has one for each joint, in their order, then those on further axes that a joint drives (mimic joints).
    ``mass_sigma`` kg and ``com_sigma`` m say how well mass and centre are known; None: a tenth of the mass, 10 mm.
    """

    element: int
    mass: float
    com: Floats
    inertia: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    mass_sigma: float | None = None
    com_sigma: float | None = None


def moved_link(link: Link, T: Floats) -> Link:
    """Return the same body in another frame: ``T (4, 4)`` is the frame it is in now, seen from the other."""
    R = T[:3, :3]
    return replace(link, com=R @ link.com + T[:3, 3], inertia=R @ link.inertia @ R.T)


@dataclass(frozen=True)
class Payload:
    """A point mass kg at ``com`` m in the tool frame."""

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Robot:
    """Nominal description of a serial arm, SI. ``gravity (3,)`` m/s² is in the robot's base frame.

    ``load`` is what it carries where no payload is stated. ``payload_sigma`` is how well payloads are known: share of
    the mass, and m of the place. ``told_loads`` is what torques say of the errors of its masses and first moments,
    ``told_friction (n, 2)`` N m what they say of the friction of each joint near rest, with its standard deviation.
    """

    name: str
    joints: tuple[Joint, ...]
    chain: Chain
    links: tuple[Link, ...] = ()
    gravity: Floats = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    T_base: Floats = field(default_factory=lambda: np.eye(4))
    T_tool: Floats = field(default_factory=lambda: np.eye(4))
    payload_sigma: tuple[float, float] = (MASS_SHARE, CENTRE_M)
    load: Payload | None = None
    told_loads: CorrelatedPrior | None = None
    told_friction: Floats | None = None

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def has_masses(self) -> bool:
        """Whether any link has a mass, without which gravity loads no joint but by the payload."""
        return any(link.mass > 0 for link in self.links)

    @property
    def limits(self) -> Floats:
        """Joint limits (n, 2)."""
        return np.array([[j.lower, j.upper] for j in self.joints], dtype=np.float64)
