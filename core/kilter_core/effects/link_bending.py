"""Bending of a link as a cantilever under its own weight and the load at its end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np

from kilter_core.arm.loads.wrenches import joint_loads
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LINK_SAG, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

SHORTEST_M = 1e-6


@dataclass(frozen=True)
class LinkBending(Effect):
    """A slender cantilever of length L along u from the joint to the next one, equally stiff in all directions across u.

    With m(s) the moment across u at s along the link, its end rotates by θ = ∫ m ds /(EI) and moves by
    δ = ∫ m × u (L − s) ds /(EI) (Euler and Bernoulli). A force F and a moment M at the end make m = M + (L − s) u × F:
    θ = M L + u × F L²/2, δ = F L³/3 + M × u L²/2. The link's own load (W, moment N at the joint) bends it up to its
    centre of mass a = ``centres_m``: m = N − s u × W for s < a. As a twist at the joint, before the link: w = θ and
    v = δ − θ × L u. One 1/(EI) per link is all there is to identify. Torsion, stretch and the travel of a prismatic joint are
    left out.
    """

    id = "link_bending"
    summary = "bending of a link under its own weight and the load at its end"
    physical = LINK_SAG
    separated_by = (Separator.LOADS,)
    source = "Euler-Bernoulli cantilever; Klimchik et al. 2014 on which link stiffnesses can be distinguished"
    needs = frozenset({"moments"})
    reads = (("wrench", (0, 1, 2, 3, 4, 5)), ("end_wrench", (0, 1, 2, 3, 4, 5)))
    signs = "positive"
    aliases = ("axial_compliance", "radial_compliance", "base_compliance", "gravity_spring")
    remedy = "usually not separable from the next joint's compliance: put a reflector on the link, or accept the class"

    centres_m: tuple[float, ...] | None = option(
        None, "Where along each link its centre of mass lies, m; null: from the robot's links."
    )

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length, with their centres of mass."""
        links = robot.chain.link_vectors[:-1]
        long = [int(j) for j in np.flatnonzero(np.linalg.norm(links, axis=1) > SHORTEST_M)]
        chosen = self.limited(robot, long, "its link has no length. Name the joint before a long link.")
        joints = chosen.acting(robot.n_joints)
        if self.centres_m is not None:
            if len(self.centres_m) != len(joints):
                raise OptionError(
                    f"link_bending needs one of centres_m for each of {len(joints)} links.", effect=self.id
                )
            return replace(chosen, joints=joints)
        centres = _centres(robot)
        return replace(chosen, joints=joints, centres_m=tuple(_along(links[j], centres[j]) for j in joints))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Flexibility 1/(EI) per link, 1/(N m²)."""
        text = "flexibility 1/(EI) of the link after this joint"
        return self.per_joint(robot, "bending", "1/(N m2)", 1e-4, 0.0, 1e-2, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist at each joint and its derivative by 1/(EI)."""
        joints = self.acting(batch.q.shape[1])
        centres = self.centres_m or (0.0,) * len(joints)
        derivatives = []
        for k, (j, a) in enumerate(zip(joints, centres, strict=True)):
            root, end = (w[:, j] for w in (batch.wrench, batch.end_wrench))
            of_root, of_end = _flexed(tuple(map(float, batch.link_vectors[j])), a)
            derivatives.append(Derivative(k, j, xi=root @ of_root + end @ of_end))
        return linear(batch, values, derivatives)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the twist of each link: linear in the wrenches on its joint and on its end."""
        chain = form.robot.chain
        if any(e.joint is not None and k not in chain.primary for k, e in enumerate(chain.elements)):
            return False  # the end of a link is then not at a constant place
        none, unit = np.zeros((6, 6)), np.eye(6)
        places = zip(self.acting(len(form.joints)), values.tolist(), self.centres_m or (), strict=True)
        for j, value, centre in places:
            link = chain.link_vectors[j]
            form.bend(j, value * bent(link, centre, unit, none).T, value * bent(link, centre, none, unit).T, link)
        return True


@lru_cache(maxsize=256)
def _flexed(link: tuple[float, ...], a: float) -> tuple[Floats, Floats]:
    """Matrices (6, 6) that map the wrench on a link's joint, and the one on its end, to its twist: it is linear."""
    one, none = np.eye(6), np.zeros((6, 6))
    return bent(np.array(link), a, one, none), bent(np.array(link), a, none, one)


def bent(link: Floats, a: float, root: Floats, end: Floats) -> Floats:
    """Twist (N, 6) at the joint of a link (3,) of EI = 1 under the wrenches (N, 6) on its joint and its end."""
    length = float(np.linalg.norm(link))
    u = link / length
    force, moment = _across(end[:, :3], u), _across(end[:, 3:], u)
    lever = np.cross(u, force)
    weight, own = _own_load(link, root, end)
    own, sideways = _across(own, u), np.cross(u, weight)
    turn = moment * length + lever * (length**2 / 2.0) + own * a - sideways * (a**2 / 2.0)
    bow = moment * (length**2 / 2.0) + lever * (length**3 / 3.0)
    bow += own * (length * a - a**2 / 2.0) - sideways * (length * a**2 / 2.0 - a**3 / 3.0)
    return np.concatenate([np.cross(bow, u) - np.cross(turn, link), turn], axis=1)


def _across(v: Floats, u: Floats) -> Floats:
    return v - np.outer(v @ u, u)


def _own_load(link: Floats, root: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Force and moment about the joint that the link itself adds to what hangs on its end."""
    return root[:, :3] - end[:, :3], root[:, 3:] - end[:, 3:] - np.cross(link, end[:, :3])


def _centres(robot: Robot) -> Floats:
    """Centre of mass (n, 3) of what each joint carries before the next, m in the joint frame; 0 without a mass.

    Weighed along three axes: the weights W and their moments c × W give Σ W × (c × W) = 2 m² c.
    """
    n = robot.n_joints
    centres = np.zeros((n, 3))
    weighed = [joint_loads(replace(robot, gravity=axis, T_tool=np.eye(4)), np.zeros((1, n))) for axis in np.eye(3)]
    for j, link in enumerate(robot.chain.link_vectors[:-1]):
        own = [_own_load(link, w.joints[:, j], w.ends[:, j]) for w in weighed]
        square = sum(float(np.sum(force**2)) for force, _ in own) / 3.0
        if square > 0.0:
            centres[j] = sum(np.cross(force, moment)[0] for force, moment in own) / (2.0 * square)
    return centres


def _along(link: Floats, centre: Floats) -> float:
    """Where along the link its centre of mass lies, kept on the link, m."""
    length = float(np.linalg.norm(link))
    return float(np.clip(centre @ link / length, 0.0, length))
