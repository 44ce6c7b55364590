"""Load wrenches on the joints: static (thesis eq. 4.21), dynamic (5.14), with payload and external wrench.

The sign is that of the *load*: what gravity and inertia of the outboard links do to the joint, so a positive
compliance makes a horizontal arm droop. Moments are taken on the chain of the robot that is given: the nominal one, or one
with constants that an earlier fit found (:class:`LoadChain`); at the joint readings, or where a
:class:`~kilter_core.arm.load_wrenches.Deflection` says that the arm hangs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.chain import Chain, axis_frame
from kilter_core.arm.kernels.newton_euler import load_wrenches
from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations
from kilter_core.parameters import indices
from kilter_core.transforms import pose_from_twist, rotation_log, rotations_about
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


ALONG, ABOUT = 2, 5  # components of a wrench that work on a joint: of a prismatic one, of a revolute one


@dataclass(frozen=True)
class Loads:
    """Loads of N rows, force N then moment N·m.

    ``joints (N, n, 6)`` on each joint in its joint frame (z is the axis); ``ends (N, n, 6)`` what follows does to the
    end of each link, about the place of the next joint (the flange for the last; a prismatic joint before it moves) but in
    the frame of the link's own joint, behind its twist; ``base (N, 6)`` on the base about its origin, in the base frame;
    ``tool_point (N, 3)`` m, the tool point in the base frame. ``linked (N, n)`` is what works on each joint through linkages
    besides: of each axis that follows it by one, its load times its motion per motion of the joint (virtual work); None
    without linkages.
    """

    joints: Floats
    ends: Floats
    base: Floats
    tool_point: Floats
    linked: Floats | None = None


def joint_loads(
    robot: Robot,
    q: Floats,
    *,
    qd: Floats | None = None,
    qdd: Floats | None = None,
    payload_kg: Floats | None = None,
    payload_com: Floats | None = None,
    external: Floats | None = None,
    link_mass: Floats | None = None,
    link_wrench: Floats | None = None,
    deflection: Deflection | None = None,
) -> Loads:
    """Load wrenches on joints, link ends and base.

    Args:
        robot: links, gravity in its base frame, and the chain and tool frame at which they hang.
        q: joint readings (N, n), rad or m.
        qd: joint speeds (N, n); with ``qdd`` the load is dynamic, without it static.
        qdd: joint accelerations (N, n).
        payload_kg: point mass (N,) kg.
        payload_com: its place (N, 3) m in the tool frame; the tool point when None.
        external: force and moment (N, 6) on the tool point in the tool frame.
        link_mass: masses (N, n, 4) that hang on the links beyond their own, kg and place m in the frame of the link; they
            weigh, whatever the arm's motion does to them is left out.
        link_wrench: force and moment (N, n, 6) on the links, about the origins and in the axes of their frames.
        deflection: how far the arm is deflected; None takes the loads at the joint readings.

    Source: thesis eq. 4.21 and 5.14, corrected (forces rotated into one frame, load sign).

    """
    chain = robot.chain
    given = (
        qd,
        qdd,
        payload_kg,
        payload_com,
        external,
        Deflection.none(*q.shape) if deflection is None else deflection,
    )
    loads = _wrenches(robot, chain.program.primary, chain.program.joint_frame, q, *given)
    on_links = (
        None
        if link_mass is None and link_wrench is None
        else OnLinks.from_link_loads(robot, q, link_mass, link_wrench, given[-1])
    )
    if on_links is not None:
        own = chain.program.primary, chain.program.joint_frame
        loads = replace(
            loads,
            joints=loads.joints + on_links.on_axes(*own),
            ends=loads.ends + on_links.on_ends(*own),
            base=loads.base + on_links.on_base(),
        )
    if not chain.linkage_axes:
        return loads
    followers = np.array(chain.linkage_axes, dtype=np.int64)
    frames = np.stack([axis_frame(chain.elements[k].axis) for k in chain.linkage_axes])
    found = _wrenches(robot, followers, frames, q, *given).joints
    if on_links is not None:
        found = found + on_links.on_axes(followers, frames)
    return replace(loads, linked=through_linkages(robot, found))


def through_linkages(robot: Robot, wrenches: Floats) -> Floats:
    """What works on each joint (..., n) through linkages, by the wrenches (..., m, 6) on the linked axes in their frames."""
    out = np.zeros((*wrenches.shape[:-2], robot.n_joints))
    for place, k in enumerate(robot.chain.linkage_axes):
        element = robot.chain.elements[k]
        component = ABOUT if element.axis.rotates else ALONG
        out[..., element.joint] += robot.chain.linkage_load_ratio(k) * wrenches[..., place, component]
    return out


def _wrenches(
    robot: Robot,
    axes: Ints,
    frames: Floats,
    q: Floats,
    qd: Floats | None,
    qdd: Floats | None,
    payload_kg: Floats | None,
    payload_com: Floats | None,
    external: Floats | None,
    deflection: Deflection,
) -> Loads:
    """Loads on the moving ``axes (m,)``, elements of the chain, in ``frames (m, 3, 3)`` whose z is the axis."""
    rows, program = len(q), robot.chain.program
    none = np.zeros((0, 0))
    dynamic = qd is not None and qdd is not None
    shape = (rows, len(axes), 6)
    loads = Loads(np.empty(shape), np.empty(shape), np.empty((rows, 6)), np.empty((rows, 3)))
    load_wrenches(
        program.axis,
        program.joint,
        program.ratio,
        program.value,
        axes,
        frames,
        np.array([link.element for link in robot.links], dtype=np.int64),
        np.array([link.mass for link in robot.links], dtype=np.float64),
        np.array([link.com for link in robot.links], dtype=np.float64).reshape(-1, 3),
        np.array([link.inertia for link in robot.links], dtype=np.float64).reshape(-1, 3, 3),
        np.ascontiguousarray(robot.gravity, dtype=np.float64),
        robot.T_tool,
        np.zeros(rows) if payload_kg is None else np.ascontiguousarray(payload_kg, dtype=np.float64),
        np.zeros((rows, 3)) if payload_com is None else np.ascontiguousarray(payload_com, dtype=np.float64),
        none if external is None else np.ascontiguousarray(external, dtype=np.float64),
        np.ascontiguousarray(q + deflection.dq, dtype=np.float64),
        np.ascontiguousarray(qd, dtype=np.float64) if dynamic and qd is not None else none,
        np.ascontiguousarray(qdd, dtype=np.float64) if dynamic and qdd is not None else none,
        twisted_elements(robot.chain),
        np.ascontiguousarray(deflection.xi),
        loads.joints,
        loads.ends,
        loads.base,
        loads.tool_point,
    )
    return loads


def row_load_wrenches(robot: Robot, o: Observations, deflection: Deflection | None = None) -> Loads:
    """Load wrenches of rows under their own conditions: motion, payload, the wrench on the tool, and loads on links."""
    return joint_loads(
        robot,
        o.q,
        qd=o.qd,
        qdd=o.qdd,
        payload_kg=o.payload_kg,
        payload_com=o.payload_com,
        external=o.wrench,
        link_mass=o.link_mass,
        link_wrench=o.link_wrench,
        deflection=deflection,
    )


def axial_loads(robot: Robot, loads: Loads) -> Floats:
    """Load (N, n) that works on each joint: moment about a revolute axis (N·m), force along a prismatic one (N).

    Of a joint that drives further axes by a linkage it is what its gear carries: the loads of all its axes by virtual work.
    """
    revolute = [joint.kind == "revolute" for joint in robot.joints]
    own = np.where(revolute, loads.joints[:, :, ABOUT], loads.joints[:, :, ALONG])
    return own if loads.linked is None else own + loads.linked


# Rounds of loads where the arm hangs, after those at the readings, in predictions and in the corrector alike: with backlash and
# clearance in their middle, and then on their sides.
HANGING_ROUNDS, SIDED_ROUNDS = 3, 2


@dataclass(frozen=True)
class Deflection:
    """Of N rows: ``dq (N, n)``, added to the joint readings, rad or m, and ``xi (N, n, 6)``, twists behind the joints.

    A twist is (v, w), m and rad, in the frame after the joint's element; ``xi`` may be empty, (0, n, 6): none.
    """

    dq: Floats
    xi: Floats

    def __add__(self, other: Deflection) -> Deflection:
        if not len(self.xi) or not len(other.xi):
            return Deflection(self.dq + other.dq, self.xi if len(self.xi) else other.xi)
        return Deflection(self.dq + other.dq, self.xi + other.xi)

    @staticmethod
    def none(rows: int, joints: int) -> Deflection:
        """Of a rigid arm."""
        return Deflection(np.zeros((rows, joints)), np.zeros((0, joints, 6)))

    def select(self, rows: slice) -> Deflection:
        """Of some of the rows."""
        return Deflection(self.dq[rows], self.xi[rows] if len(self.xi) else self.xi)


def twisted_elements(chain: Chain) -> Ints:
    """Joint (E,) whose twist stands behind each element, -1 where none does."""
    slot = np.full(len(chain.elements), -1, dtype=np.int64)
    slot[list(chain.primary)] = np.arange(chain.n_joints)
    return slot


AT_THE_TOOL_M = 0.010  # a fitted tool frame within this of the robot's own is the tool that the payload hangs on;
AT_THE_TOOL_RAD = np.radians(1.0)  # farther off it is where the target sits, and the payload stays where it was stated


@dataclass(frozen=True)
class LoadChain:
    """Chain constants ``values (K,)``, those with a name in their order, and ``T_tool (4, 4)`` at which loads are computed.

    They are constants of a model, not its parameters: a fit holds them still, so the model stays exact in its parameters,
    and they are updated between fits. Gravity stays as the robot states it, in the axes of its base frame, the origin of
    the chain: the frame of the measurements has no level, so what is fitted between the two says nothing of the vertical.
    What a fitted base takes up of the first joint's zero rotates no load about a vertical first axis; of an arm on a wall it
    stays out of the loads.

    ``effects`` are the parameters of effects by name at which the arm deflects: an arm that sags carries its weights at
    other levers, an error of its sag that grows with the square of it. Without them loads are taken at the joint readings.
    What tilts the base as a whole is left out of it: gravity stays as the robot states it.
    """

    values: Floats
    T_tool: Floats
    effects: Mapping[str, float] | None = None

    @staticmethod
    def from_fitted_values(
        robot: Robot, values: Floats, T_tool: Floats, effects: Mapping[str, float] | None = None
    ) -> LoadChain:
        """At these constants (K,), and under the tool frame where it is the robot's own but for its errors."""
        own = robot.T_tool
        apart = float(np.linalg.norm(own[:3, 3] - T_tool[:3, 3]))
        turned = float(np.linalg.norm(rotation_log((own[:3, :3].T @ T_tool[:3, :3])[None])))
        near = apart < AT_THE_TOOL_M and turned < AT_THE_TOOL_RAD
        return LoadChain(values.copy(), T_tool if near else own, effects)

    def apply_to_robot(self, robot: Robot) -> Robot:
        """The robot with these constants and this tool: what loads are computed from."""
        elements = list(robot.chain.elements)
        for k, value in zip(robot.chain.named_elements, self.values.tolist(), strict=True):
            elements[k] = replace(elements[k], value=value)
        return replace(robot, chain=Chain(tuple(elements), robot.n_joints), T_tool=self.T_tool)

    def to_document(self, robot: Robot) -> dict[str, Any]:
        """JSON-able state, SI: constants by name, tool frame, and by name what deflects where anything does."""
        document = {
            "values": dict(zip(_names(robot), self.values.tolist(), strict=True)),
            "T_tool": self.T_tool.tolist(),
        }
        return document if self.effects is None else document | {"effects": dict(self.effects)}

    @staticmethod
    def from_document(robot: Robot, document: Mapping[str, Any] | None) -> LoadChain | None:
        """Rebuild from :meth:`to_document`; None, the nominal chain, where a version has none.

        Raises:
            OptionError: a constant that the robot does not have.

        """
        if document is None:
            return None
        elements = robot.chain.elements
        values = np.array([elements[k].value for k in robot.chain.named_elements], dtype=np.float64)
        stored = document["values"]
        values[indices(_names(robot), stored)] = list(stored.values())
        effects = document.get("effects")  # earlier versions have none: their loads are at the readings
        return LoadChain(values, np.array(document["T_tool"], dtype=np.float64), effects)


def _names(robot: Robot) -> list[str]:
    return [robot.chain.elements[k].name or "" for k in robot.chain.named_elements]
