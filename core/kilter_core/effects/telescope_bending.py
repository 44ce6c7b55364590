"""Bending of an arm that a prismatic joint extends: a cantilever whose length is the reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import TELESCOPE_SAG, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

WHY = "it is bending of an arm that a joint extends, and the joint is revolute. Name prismatic joints."
REACH = (1, 2, 3)  # powers of the length that the bending has


@dataclass(frozen=True)
class TelescopeBending(Effect):
    """The part of joint i that stands out of its guide is a cantilever of length L = q − root along the axis u of the joint.

    ``roots_m`` is the reading of each joint at which nothing stands out; where q is below it, L = root − q and u points
    the other way. The load on the joint, a force F and a moment M about its frame, acts at the end: θ = M L + u × F L²/2
    and δ = F L³/3 + M × u L²/2, all across u (Euler and Bernoulli). As a twist of the joint frame, which is that end: w = θ
    and v = δ. One 1/(EI) per joint is all there is to identify. The arm's own mass counts as a load on its end.
    """

    id = "telescope_bending"
    summary = "bending of an arm that a prismatic joint extends, under the load at its end"
    physical = TELESCOPE_SAG
    separated_by = (Separator.LOADS,)
    source = "Euler-Bernoulli cantilever whose length is the reading of a prismatic joint"
    needs = frozenset({"moments"})
    reads = (("wrench", (0, 1, 3, 4)),)
    signs = "positive"
    aliases = ("guide_rotation", "straightness", "radial_compliance", "link_bending")
    remedy = "measure the extended and the retracted arm with two payloads"

    roots_m: tuple[float, ...] | None = option(
        None, "Reading of each joint at which nothing stands out of its guide, m; null: the lower end of its travel."
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on prismatic joints; nothing stands out at the lower end of their travel unless stated."""
        able = [j for j, joint in enumerate(robot.joints) if joint.kind == "prismatic"]
        chosen = self.restrict_to_joints(robot, able, WHY)
        joints = chosen.acting(robot.n_joints)
        roots = [robot.joints[j].lower for j in joints] if self.roots_m is None else list(self.roots_m)
        if len(roots) != len(joints):
            raise OptionError(
                f"telescope_bending needs one of roots_m for each of {len(joints)} joints.", effect=self.id
            )
        if not all(math.isfinite(root) for root in roots):
            raise OptionError(
                "telescope_bending needs roots_m: the joint has no lower limit at which nothing would stand out.",
                effect=self.id,
            )
        return replace(chosen, joints=joints, roots_m=tuple(roots))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Flexibility 1/(EI) per joint, 1/(N m²)."""
        text = "flexibility 1/(EI) of the arm that this joint extends"
        return self.per_joint(robot, "telescope", "1/(N m2)", 1e-4, 0.0, 1e-2, text)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of each joint and its derivative by 1/(EI)."""
        made = []
        joints = self.acting(batch.q.shape[1])
        for k, (j, root) in enumerate(zip(joints, self.roots_m or (), strict=True)):
            reach = batch.q[:, j] - root
            xi = np.zeros((len(batch), 6))
            for power, bent in zip(REACH, _bent(np.sign(reach)), strict=True):
                xi += np.abs(reach)[:, None] ** power * np.einsum("nij,nj->ni", bent, batch.wrench[:, j])
            made.append(Derivative(k, j, xi=xi))
        return linear(batch, values, made)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the twist of each joint: linear in the wrench on it, by powers of the length."""
        joints = self.acting(len(form.joints))
        for j, root, value in zip(joints, self.roots_m or (), values.tolist(), strict=True):
            joint = form.robot.joints[j]
            way = -1.0 if joint.upper - root < root - joint.lower else 1.0
            for power, bent in zip(REACH, _bent(np.array([way])), strict=True):
                form.bend(j, value * bent[0], np.zeros((6, 6)), np.zeros(3), reach=(power, root, way))
        return True


def _bent(way: Floats) -> tuple[Floats, Floats, Floats]:
    """Matrices (N, 6, 6) of the twist by the wrench, for EI = 1: of the length, its square and its cube; u is ``way`` z."""
    one, two, three = (np.zeros((len(way), 6, 6)) for _ in range(3))
    one[:, 3, 3] = one[:, 4, 4] = 1.0
    two[:, 0, 4] = two[:, 4, 0] = 0.5 * way  # M × u along x, u × F about y
    two[:, 1, 3] = two[:, 3, 1] = -0.5 * way
    three[:, 0, 0] = three[:, 1, 1] = 1.0 / 3.0
    return one, two, three
