"""Twist of a link about its own long axis by the moment it carries: an upper arm as a shaft."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LINK_TWIST, Separator
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SHORTEST_M = 1e-6


@dataclass(frozen=True)
class LinkTorsion(Effect):
    """The link of joint i, a straight shaft of length L along u to the next joint, twists by c (u · M).

    M is the moment about the end of the link, which all beyond it puts on it; as both ends of the link are on its axis, a
    force along or across u adds nothing about u that M does not hold. The rotation is about the line of the link, so the
    end itself stays where it is: the twist at the joint is w = c (u · M) u, v = 0. c = L/(GJ) is all there is to identify.
    The moment of the link's own mass beside its axis is left out.
    """

    id = "link_torsion"
    summary = "twist of a link about its own long axis under the moment it carries"
    physical = LINK_TWIST
    separated_by = (Separator.LOADS,)
    source = "Saint-Venant torsion of a shaft; Klimchik et al. 2014 on which link stiffnesses can be distinguished"
    needs = frozenset({"moments"})
    reads = (("end_wrench", (3, 4, 5)),)
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "link_bending")
    remedy = "put a reflector or an inclinometer on the end of the link, and load the arm to the side of it"

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length."""
        links = robot.chain.link_vectors[:-1]
        long = [int(j) for j in np.flatnonzero(np.linalg.norm(links, axis=1) > SHORTEST_M)]
        chosen = self.limited(robot, long, "its link has no length. Name the joint before a long link.")
        return replace(chosen, joints=chosen.acting(robot.n_joints))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance L/(GJ) per link, rad/(N m)."""
        text = "torsional compliance L/(GJ) of the link after this joint"
        return self.per_joint(robot, "torsion", "rad/(N m)", 1e-4, 0.0, 1e-2, text, rotates=True)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist behind each joint and its derivative by the compliance."""
        made = []
        for k, j in enumerate(self.acting(batch.q.shape[1])):
            u = _along(batch.link_vectors[j])
            xi = np.zeros((len(batch), 6))
            xi[:, 3:] = np.outer(batch.end_wrench[:, j, 3:] @ u, u)
            made.append(Derivative(k, j, xi=xi))
        return linear(batch, values, made)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the twist of each link: linear in the wrench on its end."""
        chain = form.robot.chain
        if any(e.joint is not None and k not in chain.primary for k, e in enumerate(chain.elements)):
            return False  # the end of a link is then not at a constant place
        for j, value in zip(self.acting(len(form.joints)), values.tolist(), strict=True):
            link = chain.link_vectors[j]
            twist = np.zeros((6, 6))
            twist[3:, 3:] = value * np.outer(_along(link), _along(link))
            form.bend(j, np.zeros((6, 6)), twist, link)
        return True


def _along(link: Floats) -> Floats:
    return np.asarray(link / np.linalg.norm(link))
