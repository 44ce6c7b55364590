"""Links that bend, twist and sag under load, and the straight shafts that they are taken for."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from kilter_core.arm.load_wrenches import joint_loads
from kilter_core.arm.robot import STANDARD_GRAVITY, Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import SHORTEST_M, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import LINK_SAG, LINK_TWIST, TELESCOPE_SAG, TOOL_SAG, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.transforms import rotation_along
from kilter_core.types import Floats

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


@dataclass(frozen=True)
class ToolSag(Effect):
    """The tool moves, without rotation, by s F/g across its axis: F is the weight of the payload, g standard gravity.

    ``axis`` is the tool's z in the frame of the last joint, from the robot: along it the adapter is stiff. The force is
    the one on the end of the last link, so it holds inertia and measured forces where the rows have them.
    """

    id = "tool_sag"
    summary = "tool or adapter sags under the payload"
    physical = TOOL_SAG
    separated_by = (Separator.LOADS,)
    source = "Euler-Bernoulli cantilever, deflection of its end in proportion to the load"
    needs = frozenset({"moments", "payload_kg"})
    signs = "positive"
    aliases = ("link_bending", "radial_compliance", "axial_compliance")
    remedy = "measure two loads with the tool pointing sideways and down, or a reflector on the flange besides"
    at_joints = False
    reads = (("end_wrench", (0, 1, 2)),)

    axis: tuple[float, ...] | None = option(
        None, "The tool's z in the frame of the last joint, along which nothing sags; null: from the robot."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis is not None and (len(self.axis) != 3 or not np.linalg.norm(self.axis) > 0.0):
            raise OptionError(f"tool_sag has axis {self.axis!r}: give three numbers, not all 0.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Find the tool's axis in the frame of the last joint."""
        if self.axis is not None:
            return self
        return replace(self, axis=tuple(float(x) for x in _tool_axis(robot)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Sag s of the tool per kilogram, m/kg."""
        return (Parameter("sag_per_kg", "m/kg", 0.0, 1e-4, 0.0, 2e-3, "sag of the tool per kilogram of payload"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift behind the last joint, and its derivative by s."""
        carried = np.asarray(self.column(batch, "payload_kg"), dtype=np.float64) > 0.0
        xi = np.zeros((len(batch), 6))
        xi[:, :3] = carried[:, None] * (batch.end_wrench[:, -1, :3] @ sagging(self.axis or (0.0, 0.0, 1.0)))
        return linear(batch, values, [Derivative(0, batch.q.shape[1] - 1, xi=xi)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the sag behind the last joint by the load on the end of its link, where a payload hangs."""
        if form.conditions.payload_kg == 0.0:
            return True
        moved = np.zeros((6, 6))
        moved[:3, :3] = float(values[0]) * sagging(self.axis or (0.0, 0.0, 1.0)).T
        form.bend(len(form.joints) - 1, np.zeros((6, 6)), moved, np.zeros(3))
        return True


def sagging(axis: tuple[float, ...]) -> Floats:
    """Matrix (3, 3) that makes of a force N on the tool its share across the ``axis``, in kilograms."""
    u = np.asarray(axis, dtype=np.float64)
    u = u / np.linalg.norm(u)
    return np.asarray((np.eye(3) - np.outer(u, u)) / STANDARD_GRAVITY)


def _tool_axis(robot: Robot) -> Floats:
    """z of the tool frame (3,) in the frame of the last joint: through the constants between them."""
    chain = robot.chain
    turn = chain.program.joint_frame[-1].T
    for e in chain.elements[chain.primary[-1] + 1 :]:
        if e.axis.rotates and e.joint is None:
            turn = turn @ rotation_along(e.axis % 3, e.value)
    return np.asarray(turn @ robot.T_tool[:3, 2])
