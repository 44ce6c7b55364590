"""Links as straight shafts that deflect under load: where each leads, and what it carries. Shared by effects; none itself."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from kilter_core.arm.loads.wrenches import joint_loads
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.types import Floats

SHORTEST_M = 1e-6
PARALLEL = 1e-3  # rad between axes: an error of assembly, not a design
WRENCH = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True)
class Shaft:
    """A straight shaft of ``length`` m along the unit vector ``u (3,)`` from its joint; all in the frame of that joint.

    The next joint is ``beside (3,)`` m from its end, held rigidly, and ``link (3,)`` m from its joint. The link's own mass
    hangs on it ``centre`` m along it, wherever beside it.
    """

    u: Floats
    length: float
    link: Floats
    centre: float

    @property
    def offset_to_next_joint(self) -> Floats:
        """From the end of the shaft to the next joint, across it."""
        return np.asarray(self.link - self.length * self.u)

    def across(self, v: Floats) -> Floats:
        """Part of vectors (N, 3) across the shaft."""
        return np.asarray(v - np.outer(v @ self.u, self.u))


def own_load(link: Floats, root: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Force and moment about the joint (N, 3) that a link adds to what hangs on its end, by the wrenches (N, 6) on both."""
    return root[:, :3] - end[:, :3], root[:, 3:] - end[:, 3:] - np.cross(link, end[:, :3])


Twists = Callable[[Shaft, Floats, Floats], Floats]


@dataclass(frozen=True)
class LinkShafts(Effect):
    """What shafts do under load is a twist behind their joint, linear in the wrenches on the joint and on the link's end.

    The shaft of a link goes through its joint and leads to the next one. Where the axes of both are parallel, how far apart
    the joints are along them is an offset beside the arm, as a description likes to draw it, and not the way of the shaft:
    it is then across the axes.
    """

    needs = frozenset({"moments"})
    reads = (("wrench", WRENCH), ("end_wrench", WRENCH))
    signs = "positive"
    # At least: stiff links left 6 % of what loads bend in an arm (Oliveira 2021), and are taken as stiff (Dumas 2011).
    rarer = 2.0

    directions: tuple[tuple[float, ...], ...] | None = option(
        None, "Direction of each link's shaft in the frame of its joint; null: to the next joint, across parallel axes."
    )
    centres_m: tuple[float, ...] | None = option(
        None, "Where along each link's shaft its centre of mass lies, m; null: from the robot's links."
    )

    @staticmethod
    @abstractmethod
    def twists(shaft: Shaft, root: Floats, end: Floats) -> Floats:
        """Twist (N, 6) behind the joint of a shaft, per unit of its parameter, by the wrenches (N, 6) on joint and end."""

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on the links that have a length, along their shafts, with their centres of mass."""
        links = robot.chain.link_vectors[:-1]
        long = [int(j) for j in np.flatnonzero(np.linalg.norm(links, axis=1) > SHORTEST_M)]
        chosen = self.restrict_to_joints(robot, long, "its link has no length. Name the joint before a long link.")
        joints = chosen.acting(robot.n_joints)
        ways = (
            [_way(robot, j) for j in joints] if self.directions is None else self._validated_directions(robot, joints)
        )
        if self.centres_m is None:
            masses = _centres(robot)
            centres = tuple(_along(links[j], way, masses[j]) for j, way in zip(joints, ways, strict=True))
        elif len(self.centres_m) == len(joints):
            centres = self.centres_m
        else:
            raise OptionError(f"{self.id} needs one of centres_m for each of {len(joints)} links.", effect=self.id)
        directions = self.directions or tuple(tuple(way.tolist()) for way in ways)
        return replace(chosen, joints=joints, directions=directions, centres_m=centres)

    def _validated_directions(self, robot: Robot, joints: tuple[int, ...]) -> list[Floats]:
        """The directions as unit vectors; refused where they are none, or lead to no end of the link."""
        ways = [np.array(way, dtype=np.float64) for way in self.directions or ()]
        sizes = [float(np.linalg.norm(way)) if len(way) == 3 else 0.0 for way in ways]
        if len(sizes) != len(joints) or not all(0.0 < size < np.inf for size in sizes):
            raise OptionError(
                f"{self.id} needs one of directions, three numbers that are not all 0, for each of {len(joints)} links.",
                effect=self.id,
            )
        ways = [way / size for way, size in zip(ways, sizes, strict=True)]
        for j, way in zip(joints, ways, strict=True):
            if abs(way @ robot.chain.link_vectors[j]) <= SHORTEST_M:
                raise OptionError(
                    f"{self.id} has a direction across the link after joint {j + 1}: give the one along its shaft, "
                    "in the frame of that joint, or none for the way to the next joint.",
                    effect=self.id,
                )
        return ways

    def as_stored(self, robot: Robot, document: Mapping[str, Any]) -> Self:
        """Shafts of versions that state none lead to the next joint, parallel or not."""
        if "directions" in document:
            return self
        lines = robot.chain.link_vectors[list(self.acting(robot.n_joints))]
        return replace(self, directions=tuple(tuple(line) for line in lines.tolist()))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist behind each joint and its derivative by the parameter of its link."""
        made = []
        for k, (j, of_root, of_end) in enumerate(self._matrices(batch.q.shape[1], batch.link_vectors)):
            made.append(Derivative(k, j, xi=batch.wrench[:, j] @ of_root + batch.end_wrench[:, j] @ of_end))
        return linear(batch, values, made)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the twist of each link: linear in the wrenches on its joint and on its end."""
        chain = form.robot.chain
        if any(e.joint is not None and k not in chain.primary for k, e in enumerate(chain.elements)):
            return False  # the end of a link is then not at a constant place
        own = self._matrices(len(form.joints), chain.link_vectors)
        for (j, of_root, of_end), value in zip(own, values.tolist(), strict=True):
            form.bend(j, value * of_root.T, value * of_end.T, chain.link_vectors[j])
        return True

    def _matrices(self, n_joints: int, links: Floats) -> Iterator[tuple[int, Floats, Floats]]:
        """Joints, with the matrices (6, 6) that map wrenches on the joint and on the end of its link to the twist."""
        places = zip(self.acting(n_joints), self.directions or (), self.centres_m or (), strict=True)
        for j, way, centre in places:
            of_root, of_end = _matrices(self.twists, tuple(map(float, links[j])), way, centre)
            yield j, of_root, of_end


@lru_cache(maxsize=512)
def _matrices(twists: Twists, link: tuple[float, ...], way: tuple[float, ...], centre: float) -> tuple[Floats, Floats]:
    u = np.array(way) / np.linalg.norm(way)
    length = float(u @ link)
    shaft = Shaft(u if length > 0.0 else -u, abs(length), np.array(link), centre)
    unit, none = np.eye(6), np.zeros((6, 6))
    return twists(shaft, unit, none), twists(shaft, none, unit)


def _way(robot: Robot, joint: int) -> Floats:
    """Unit vector of a link's shaft: to the next joint, less the offset along this axis where both are parallel."""
    link = robot.chain.link_vectors[joint]
    across = link * [1.0, 1.0, 0.0]
    parallel = abs(robot.chain.next_axes[joint, 2]) > np.cos(PARALLEL)
    way = across if parallel and np.linalg.norm(across) > SHORTEST_M else link
    return np.asarray(way / np.linalg.norm(way))


def _along(link: Floats, way: Floats, centre: Floats) -> float:
    """Where along a shaft its centre of mass lies, kept on the shaft, m."""
    length = float(way @ link)
    return float(np.clip(np.sign(length) * (way @ centre), 0.0, abs(length)))


def _centres(robot: Robot) -> Floats:
    """Centre of mass (n, 3) of what each joint carries before the next, m in the joint frame; 0 without a mass.

    Weighed along three axes: the weights W and their moments c × W give Σ W × (c × W) = 2 m² c.
    """
    n = robot.n_joints
    centres = np.zeros((n, 3))
    weighed = [joint_loads(replace(robot, gravity=axis, T_tool=np.eye(4)), np.zeros((1, n))) for axis in np.eye(3)]
    for j, link in enumerate(robot.chain.link_vectors[:-1]):
        own = [own_load(link, w.joints[:, j], w.ends[:, j]) for w in weighed]
        square = sum(float(np.sum(force**2)) for force, _ in own) / 3.0
        if square > 0.0:
            centres[j] = sum(np.cross(force, moment)[0] for force, moment in own) / (2.0 * square)
    return centres
