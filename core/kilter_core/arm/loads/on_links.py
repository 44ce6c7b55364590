"""Loads on links that the joints do not describe: a mass that something else moves, a force or a moment, row by row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.loads.deflection import Deflection
from kilter_core.arm.robot import Robot
from kilter_core.transforms import pose_from_twist, rotations_about
from kilter_core.types import Floats, Ints

MASS = 4  # numbers of a mass on a link: kg, then its place m
Place = tuple[Floats, Floats]  # rotations (N, 3, 3) and points (N, 3) m, seen from the base frame


@dataclass(frozen=True)
class OnLinks:
    """Forces (n, N, 3) N on the links and their moments about the origin of the base frame, and where N rows stand.

    ``elements (n,)`` are those whose frame each link has; ``before`` and ``after`` say where the frames of moving
    elements are and ``behind`` where those behind their twists, ``flange (N, 3)`` where the chain ends.
    """

    elements: Ints
    force: Floats
    moment: Floats
    before: dict[int, Floats]
    after: dict[int, Place]
    behind: dict[int, Place]
    flange: Floats

    @staticmethod
    def from_link_loads(
        robot: Robot, q: Floats, mass: Floats | None, wrench: Floats | None, hung: Deflection
    ) -> OnLinks:
        """Of rows ``q (N, n)``: masses (N, n, 4) that weigh, and wrenches (N, n, 6) about the origins of the links' frames.

        Both are in the frames right after the elements of the joints, where the robot states centres of mass.
        """
        elements = np.array(robot.chain.primary, dtype=np.int64)
        before, after, behind, flange = _element_frames(robot, q, hung)
        force, moment = (np.zeros((len(elements), len(q), 3)) for _ in range(2))
        for j, e in enumerate(elements.tolist()):
            R, p = behind[e]
            if mass is not None:
                weight = mass[:, j, :1] * robot.gravity
                force[j] += weight
                moment[j] += np.cross(p + np.einsum("nab,nb->na", R, mass[:, j, 1:]), weight)
            if wrench is not None:
                pull, turn = (np.einsum("nab,nb->na", R, wrench[:, j, part]) for part in (slice(0, 3), slice(3, 6)))
                force[j] += pull
                moment[j] += turn + np.cross(p, pull)
        return OnLinks(elements, force, moment, before, after, behind, flange)

    def on_axes(self, axes: Ints, frames: Floats) -> Floats:
        """Loads (N, m, 6) on moving ``axes (m,)``, elements of the chain, in ``frames (m, 3, 3)`` after them."""
        made = [self._wrench_about_point(e, self.after[e][0] @ F, self.after[e][1]) for e, F in _each(axes, frames)]
        return np.stack(made, axis=1)

    def on_ends(self, axes: Ints, frames: Floats) -> Floats:
        """Loads (N, m, 6) on the ends of the links behind these axes, about where the next of them stands before it moves."""
        made = []
        for e, F in _each(axes, frames):
            following = min((k for k in axes.tolist() if k > e), default=None)
            where = self.flange if following is None else self.before[following]
            beyond = 1 + int(self.elements.max()) if following is None else following
            made.append(self._wrench_about_point(beyond, self.behind[e][0] @ F, where))
        return np.stack(made, axis=1)

    def on_base(self) -> Floats:
        """Load (N, 6) on the base about its origin."""
        return np.hstack([self.force.sum(axis=0), self.moment.sum(axis=0)])

    def _wrench_about_point(self, element: int, R: Floats, p: Floats) -> Floats:
        """What the links from an element on put on a point, in the axes of R."""
        beyond = self.elements >= element
        force, moment = self.force[beyond].sum(axis=0), self.moment[beyond].sum(axis=0)
        about = moment - np.cross(p, force)
        return np.hstack([np.einsum("nba,nb->na", R, v) for v in (force, about)])


def _each(axes: Ints, frames: Floats) -> Iterator[tuple[int, Floats]]:
    return zip(axes.tolist(), frames, strict=True)


def _element_frames(
    robot: Robot, q: Floats, hung: Deflection
) -> tuple[dict[int, Floats], dict[int, Place], dict[int, Place], Floats]:
    """Where the moving elements stand before and after they move and behind their twists, and the flange."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    before: dict[int, Floats] = {}
    after: dict[int, Place] = {}
    behind: dict[int, Place] = {}
    behind_joint = {e: j for j, e in enumerate(robot.chain.primary)}
    for k, element in enumerate(robot.chain.elements):
        amount = np.full(len(q), element.value)
        if element.joint is not None:
            amount = amount + element.ratio * (q + hung.dq)[:, element.joint]
            before[k] = p
        axis = element.axis % 3
        if element.axis.rotates:
            R = R @ rotations_about(np.eye(3)[axis], amount)
        else:
            p = p + R[:, :, axis] * amount[:, None]
        if element.joint is not None:
            after[k] = R, p
            if k in behind_joint and len(hung.xi):
                step = np.stack([pose_from_twist(xi[:3], xi[3:]) for xi in hung.xi[:, behind_joint[k]]])
                R, p = R @ step[:, :3, :3], p + np.einsum("nab,nb->na", R, step[:, :3, 3])
            behind[k] = R, p
    return before, after, behind, p
