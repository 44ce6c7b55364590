"""Bending of a link as a cantilever under the load at its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from core.effects.base import Batch, Derivative, Effect, Floats, Local, linear
from core.observations import Observations
from core.parameters import Parameter
from core.robot import Robot

SHORTEST_M = 1e-6


@dataclass(frozen=True)
class LinkBending(Effect):
    """A slender beam of length L along u from the joint to the origin of the next, as stiff in all directions across u.

    A force F and a moment M at its end (across u) turn the end by θ = (M L + u × F L²/2)/EI and move it by
    δ = (F L³/3 + M × u L²/2)/EI (Euler and Bernoulli). As a twist at the joint, before the link: w = θ and
    v = δ − θ × L u. One 1/(EI) per link is all there is to identify.
    The link's own weight, torsion and stretch are left out; a slide's travel is not part of its link.
    """

    id = "link_bending"
    summary = "bending of a link under the load at its end"
    source = "Euler-Bernoulli cantilever; Klimchik et al. 2014 on which link stiffnesses can be told apart"
    needs = frozenset({"moments"})
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "base_compliance", "gravity_spring")
    remedy = "usually not separable from the next joint's compliance: put a reflector on the link, or accept the class"

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length."""
        lengths = np.linalg.norm(robot.chain.link_vectors[:-1], axis=1)
        long = [int(j) for j in np.flatnonzero(lengths > SHORTEST_M)]
        return self.limited(robot, long, "its link has no length. Name the joint before a long link.")

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Flexibility 1/(EI) per link, 1/(N m²)."""
        text = "flexibility 1/(EI) of the link after this joint"
        return self.per_joint(robot, "bending", "1/(N m2)", 1e-4, 0.0, 1e-2, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist at each joint and its derivative by 1/(EI)."""
        acting = enumerate(self.acting(batch.q.shape[1]))
        bent = [(k, j, _bent(batch.link_vectors[j], batch.end_wrench[:, j])) for k, j in acting]
        return linear(batch, values, [Derivative(k, j, xi=xi) for k, j, xi in bent])


def _bent(link: Floats, end: Floats) -> Floats:
    """Twist (N, 6) at the joint of a link (3,) of EI = 1 under the wrench (N, 6) on its end."""
    length = float(np.linalg.norm(link))
    u = link / length
    force = end[:, :3] - np.outer(end[:, :3] @ u, u)
    moment = end[:, 3:] - np.outer(end[:, 3:] @ u, u)
    turn = moment * length + np.cross(u, force) * (length**2 / 2.0)
    shift = force * (length**3 / 3.0) + np.cross(moment, u) * (length**2 / 2.0)
    return np.concatenate([shift - np.cross(turn, link), turn], axis=1)
