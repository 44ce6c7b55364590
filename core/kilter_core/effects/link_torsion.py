"""Twist of a link about its own long axis by the moment it carries: an upper arm as a shaft."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LINK_TWIST, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SHORTEST_M = 1e-6
PARALLEL = 1e-3  # rad between axes: an error of assembly, not a design


@dataclass(frozen=True)
class LinkTorsion(Effect):
    """The link of joint i, a straight shaft of length L along u through that joint, twists by c (u · M).

    M is the moment about the joint's origin of all that hangs on the end of the link. The rotation is about the line of the
    shaft: the twist at the joint is w = c (u · M) u, v = 0. c = L/(GJ) is all there is to identify. The moment of the link's
    own mass beside its axis is left out. u leads to the next joint. Where that one is parallel to this one, how far apart
    they are along themselves is an offset beside the arm, as a description likes to draw it, and not the way of the shaft:
    u is then across the axes.
    """

    id = "link_torsion"
    summary = "twist of a link about its own long axis under the moment it carries"
    physical = LINK_TWIST
    separated_by = (Separator.LOADS,)
    source = "Saint-Venant torsion of a shaft; Klimchik et al. 2014 on which link stiffnesses can be distinguished"
    needs = frozenset({"moments"})
    reads = (("end_wrench", (0, 1, 2, 3, 4, 5)),)
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "link_bending")
    remedy = "put a reflector or an inclinometer on the end of the link, and load the arm to the side of it"

    directions: tuple[tuple[float, ...], ...] | None = option(
        None, "Direction of each link's shaft in the frame of its joint; null: to the next joint, across parallel axes."
    )

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length, along their shafts."""
        links = robot.chain.link_vectors[:-1]
        long = [int(j) for j in np.flatnonzero(np.linalg.norm(links, axis=1) > SHORTEST_M)]
        chosen = self.limited(robot, long, "its link has no length. Name the joint before a long link.")
        joints = chosen.acting(robot.n_joints)
        if self.directions is None:
            return replace(chosen, joints=joints, directions=tuple(tuple(_shaft(robot, j).tolist()) for j in joints))
        sizes = [float(np.linalg.norm(u)) if len(u) == 3 else 0.0 for u in self.directions]
        if len(sizes) != len(joints) or not all(0.0 < size < np.inf for size in sizes):
            raise OptionError(
                f"link_torsion needs one of directions, three numbers that are not all 0, for each of {len(joints)} links.",
                effect=self.id,
            )
        return replace(chosen, joints=joints)

    def as_stored(self, robot: Robot, document: Mapping[str, Any]) -> Self:
        """Shafts of versions that state none lead to the next joint, parallel or not."""
        if "directions" in document:
            return self
        lines = robot.chain.link_vectors[list(self.acting(robot.n_joints))]
        return replace(self, directions=tuple(tuple(line) for line in lines.tolist()))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Compliance L/(GJ) per link, rad/(N m)."""
        text = "torsional compliance L/(GJ) of the link after this joint"
        return self.per_joint(robot, "torsion", "rad/(N m)", 1e-4, 0.0, 1e-2, text, rotates=True)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist behind each joint and its derivative by the compliance."""
        made = []
        for k, (j, shaft) in enumerate(self._shafts(batch.q.shape[1])):
            xi = np.zeros((len(batch), 6))
            xi[:, 3:] = np.outer(batch.end_wrench[:, j] @ _moment(shaft, batch.link_vectors[j]), shaft)
            made.append(Derivative(k, j, xi=xi))
        return linear(batch, values, made)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the twist of each link: linear in the wrench on its end."""
        chain = form.robot.chain
        if any(e.joint is not None and k not in chain.primary for k, e in enumerate(chain.elements)):
            return False  # the end of a link is then not at a constant place
        shafts = self._shafts(len(form.joints))
        for (j, shaft), value in zip(shafts, values.tolist(), strict=True):
            link = chain.link_vectors[j]
            twist = np.zeros((6, 6))
            twist[3:] = value * np.outer(shaft, _moment(shaft, link))
            form.bend(j, np.zeros((6, 6)), twist, link)
        return True

    def _shafts(self, n_joints: int) -> list[tuple[int, Floats]]:
        """Joints with the unit vectors of their shafts."""
        along = np.array(self.directions)
        return list(zip(self.acting(n_joints), along / np.linalg.norm(along, axis=1)[:, None], strict=True))


def _shaft(robot: Robot, joint: int) -> Floats:
    """Unit vector of a link's shaft: to the next joint, less the offset along this axis where both are parallel."""
    link = robot.chain.link_vectors[joint]
    across = link * [1.0, 1.0, 0.0]
    parallel = abs(robot.chain.next_axes[joint, 2]) > np.cos(PARALLEL)
    way = across if parallel and np.linalg.norm(across) > SHORTEST_M else link
    return np.asarray(way / np.linalg.norm(way))


def _moment(shaft: Floats, link: Floats) -> Floats:
    """What makes, of a wrench on the end of a link, its moment about the shaft through the joint (6,)."""
    return np.concatenate([np.cross(shaft, link), shaft])
