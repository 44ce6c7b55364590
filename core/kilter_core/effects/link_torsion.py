"""Twist of a link about its own long axis by the moment it carries: an upper arm as a shaft."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.link_shafts import LinkShafts, Shaft, own_load
from kilter_core.effects.physical import LINK_TWIST, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class LinkTorsion(LinkShafts):
    """The link of joint i, a straight shaft of length L along u through that joint, twists by c (u · M + a/L u · N).

    M is the moment about the joint's origin of all that hangs on the end of the link, N that of the link's own mass, which
    lies beside the shaft and twists it up to its own place a = ``centres_m``. The rotation is about the line of the shaft: the
    twist at the joint is w = c (u · M + a/L u · N) u, v = 0. c = L/(GJ) is all there is to identify.
    """

    id = "link_torsion"
    summary = "twist of a link about its own long axis under the moment it carries"
    physical = LINK_TWIST
    separated_by = (Separator.LOADS,)
    source = "Saint-Venant torsion of a shaft; Klimchik et al. 2014 on which link stiffnesses can be distinguished"
    aliases = ("axial_compliance", "radial_compliance", "link_bending")
    remedy = "put a reflector or an inclinometer on the end of the link, and load the arm to the side of it"

    def as_stored(self, robot: Robot, document: Mapping[str, Any]) -> Self:
        """Links of versions that state no centres were twisted by what hangs on their ends alone."""
        kept = super().as_stored(robot, document)
        return kept if "centres_m" in document else replace(kept, centres_m=(0.0,) * len(self.acting(robot.n_joints)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance L/(GJ) per link, rad/(N m)."""
        text = "torsional compliance L/(GJ) of the link after this joint"
        return self.per_joint(robot, "torsion", "rad/(N m)", 1e-4, 0.0, 1e-2, text, rotates=True)

    @staticmethod
    def twists(shaft: Shaft, root: Floats, end: Floats) -> Floats:
        """Twist (N, 6) at the joint of a link of L/(GJ) = 1 under the wrenches (N, 6) on its joint and its end."""
        beyond = end[:, 3:] + np.cross(shaft.link, end[:, :3])
        _, own = own_load(shaft.link, root, end)
        about = (beyond + shaft.centre / shaft.length * own) @ shaft.u
        return np.concatenate([np.zeros((len(end), 3)), np.outer(about, shaft.u)], axis=1)
