"""Bending of a link as a cantilever under its own weight and the load at its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.link_shafts import LinkShafts, Shaft, own_load
from kilter_core.effects.physical import LINK_SAG, Separator
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class LinkBending(LinkShafts):
    """A slender cantilever of length L along u through the joint, equally stiff in all directions across u.

    With m(s) the moment across u at s along the link, its end rotates by θ = ∫ m ds /(EI) and moves by
    δ = ∫ m × u (L − s) ds /(EI) (Euler and Bernoulli). A force F and a moment M at the end make m = M + (L − s) u × F:
    θ = M L + u × F L²/2, δ = F L³/3 + M × u L²/2. What hangs beside the end adds its moment to M. The link's own load (W,
    moment N at the joint) bends it up to its centre of mass a = ``centres_m``: m = N − s u × W for s < a. As a twist at the
    joint, before the link: w = θ and v = δ − θ × L u. One 1/(EI) per link is all there is to identify. Torsion, stretch and
    the travel of a prismatic joint are left out.
    """

    id = "link_bending"
    summary = "bending of a link under its own weight and the load at its end"
    physical = LINK_SAG
    separated_by = (Separator.LOADS,)
    source = "Euler-Bernoulli cantilever; Klimchik et al. 2014 on which link stiffnesses can be distinguished"
    aliases = ("axial_compliance", "radial_compliance", "base_compliance", "gravity_spring")
    remedy = "usually not separable from the next joint's compliance: put a reflector on the link, or accept the class"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Flexibility 1/(EI) per link, 1/(N m²)."""
        text = "flexibility 1/(EI) of the link after this joint"
        return self.per_joint(robot, "bending", "1/(N m2)", 1e-4, 0.0, 1e-2, text)

    @staticmethod
    def twists(shaft: Shaft, root: Floats, end: Floats) -> Floats:
        """Twist (N, 6) at the joint of a link of EI = 1 under the wrenches (N, 6) on its joint and its end."""
        u, length, a = shaft.u, shaft.length, shaft.centre
        force = shaft.across(end[:, :3])
        moment = shaft.across(end[:, 3:] + np.cross(shaft.offset_to_next_joint, end[:, :3]))
        lever = np.cross(u, force)
        weight, own = own_load(shaft.link, root, end)
        own, sideways = shaft.across(own), np.cross(u, weight)
        turn = moment * length + lever * (length**2 / 2.0) + own * a - sideways * (a**2 / 2.0)
        bow = moment * (length**2 / 2.0) + lever * (length**3 / 3.0)
        bow += own * (length * a - a**2 / 2.0) - sideways * (length * a**2 / 2.0 - a**3 / 3.0)
        return np.concatenate([np.cross(bow, u) - np.cross(turn, length * u), turn], axis=1)
