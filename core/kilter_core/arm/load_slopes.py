"""How loads follow errors of the masses: of the links and of the payload. A load is linear in mass and first moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kilter_core.arm.chain import axis_frame
from kilter_core.arm.kernels.load_slopes import load_slopes
from kilter_core.arm.load_wrenches import ABOUT, ALONG, Deflection, Loads, joint_loads, twisted_elements
from kilter_core.arm.robot import Link, Robot
from kilter_core.observations import Observations
from kilter_core.types import Floats, Ints

EACH = 4  # numbers of a body: mass, then three of its place
LIGHTEST_KG = 1e-9
NO_COLUMNS = (-1,) * EACH  # of a body that these rows do not have
POINTS = {"wrench": 0, "axial": 0, "end_wrench": 1, "base_wrench": 2}  # where a load works, as the kernel numbers it
NONE = np.zeros(0)
Parts = tuple[Floats, ...]  # of loads: wrenches on joints, on ends and on the base, and what works through linkages
# Components of each load that effects read together.
ACROSS, REST = (3, 4), (0, 1, 2, 5)
TOGETHER = {
    "axial": ((0,),),
    "wrench": (ACROSS, REST),
    "end_wrench": ((0, 1, 2, 3, 4, 5),),
    "base_wrench": (ACROSS, REST),
}


@dataclass(frozen=True)
class LoadSlopes:
    """Derivatives of the loads of N rows by K load errors, four of each link that has a mass and four of the payload.

    Of a link: mass at its stated centre, kg, and first moment beyond, kg m, along the axes of its frame. Of the payload,
    in rows that carry one: mass at its stated place, kg, and shift of that place along the axes of the tool, m. Nothing
    is computed before it is read, and of loads at rest no component that is not: those of thousands of rows fill the
    memory. Products of two errors are left out, so the loads are linear in them. They are taken where ``deflection`` says
    that the arm hangs, at the joint readings where it is None. ``whole`` has the rows, if they are some of those of another.
    """

    robot: Robot
    rows: Observations
    deflection: Deflection | None = None
    whole: tuple[LoadSlopes, slice] | None = None
    _made: dict[tuple[str, tuple[int, ...]], Floats] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def bodies(self) -> tuple[int, ...]:
        """Links (from 0) that have a mass; their errors come first."""
        return links_with_mass(self.robot)

    @cached_property
    def has_payload(self) -> bool:
        """Whether any row carries a payload."""
        if self.whole is not None:
            return self.whole[0].has_payload
        kg = self.rows.payload_kg
        return kg is not None and bool(np.any(kg > 0.0))

    def select_rows(self, rows: slice) -> LoadSlopes:
        """The same of some of the rows, as views of what is computed for all."""
        deflection = None if self.deflection is None else self.deflection.select(rows)
        return LoadSlopes(self.robot, self.rows.select(rows), deflection, (self, rows))

    def __len__(self) -> int:
        return EACH * (len(self.bodies) + self.has_payload)

    @property
    def payload(self) -> tuple[int, ...]:
        """Columns of the payload; none without one."""
        return tuple(range(EACH * len(self.bodies), len(self)))

    def component_slopes(self, name: str, part: int) -> Floats:
        """Of a component of the loads as a batch names them, (K, N, n); of the base's (K, N)."""
        if self.whole is not None:
            return self.whole[0].component_slopes(name, part)[:, self.whole[1]]
        parts = _group(name, part)
        if (name, parts) not in self._made:
            self._made[name, parts] = self._static_slopes(name, parts) if self._rests else self._moving(name, parts)
        made: Floats = self._made[name, parts][parts.index(part)]
        return made[:, :, 0] if name == "base_wrench" else made

    def changes(self, name: str, parts: tuple[int, ...], errors: Floats) -> Floats:
        """Changes (C, N, n) of components of the loads, of the base's (C, N), by load errors (K,)."""
        whole = self.whole[0] if self.whole is not None else self
        if not self._rests or any((name, _group(name, part)) in whole._made for part in parts):
            made = (self.component_slopes(name, part) for part in parts)
            return np.stack([(errors @ by.reshape(len(by), -1)).reshape(by.shape[1:]) for by in made])
        found = self._static_slopes(name, parts, errors)[:, 0]  # no slopes are kept that no derivative asked for
        return found[:, :, 0] if name == "base_wrench" else found

    @property
    def _rests(self) -> bool:
        return self.rows.qd is None or self.rows.qdd is None

    def _static_slopes(self, name: str, parts: tuple[int, ...], errors: Floats = NONE) -> Floats:
        """Slopes (C, K, N, n), or with ``errors (K,)`` changes (C, 1, N, n)."""
        robot, n = self.robot, self.robot.n_joints
        components = np.tile(np.array(parts), (1 if name == "base_wrench" else n, 1))
        if name == "axial":
            components[:, 0] = [ABOUT if joint.kind == "revolute" else ALONG for joint in robot.joints]
        program = robot.chain.program
        found = self._on_axes(program.primary, program.joint_frame, POINTS[name], components, errors)
        if name != "axial" or not robot.chain.linkage_axes:
            return found
        followers = [robot.chain.elements[k] for k in robot.chain.linkage_axes]
        frames = np.stack([axis_frame(e.axis) for e in followers])
        at = np.array([[ABOUT if e.axis.rotates else ALONG] for e in followers])
        ours = self._on_axes(np.array(robot.chain.linkage_axes, dtype=np.int64), frames, POINTS[name], at, errors)
        for place, k in enumerate(robot.chain.linkage_axes):
            found[..., followers[place].joint] += robot.chain.linkage_load_ratio(k) * ours[..., place]
        return found

    def _on_axes(self, axes: Ints, frames: Floats, point: int, components: Ints, errors: Floats) -> Floats:
        """Slopes or changes (C, K, N, m) of ``components (m, C)`` of the loads on the moving ``axes`` in their frames."""
        o, robot = self.rows, self.robot
        rows = len(o.q)
        hung = Deflection.none(*o.q.shape) if self.deflection is None else self.deflection
        program, links = robot.chain.program, [robot.links[k] for k in self.bodies]
        kg = np.zeros(rows) if o.payload_kg is None else np.where(o.payload_kg > 0.0, o.payload_kg, 0.0)
        out = np.empty((components.shape[1], 1 if len(errors) else len(self), rows, len(components)))
        load_slopes(
            program.axis,
            program.joint,
            program.ratio,
            program.value,
            axes,
            frames,
            np.array([link.element for link in links], dtype=np.int64),
            np.array([link.com for link in links], dtype=np.float64).reshape(-1, 3),
            np.ascontiguousarray(robot.gravity, dtype=np.float64),
            np.ascontiguousarray(robot.T_tool),
            (kg > 0.0).astype(np.float64),
            kg,
            np.ascontiguousarray(payload_place(o)),
            np.ascontiguousarray(o.q + hung.dq, dtype=np.float64),
            twisted_elements(robot.chain),
            np.ascontiguousarray(hung.xi),
            np.full(len(components), point, dtype=np.int64),
            components,
            errors,
            out,
        )
        return out

    def _moving(self, name: str, parts: tuple[int, ...]) -> Floats:
        if name == "base_wrench":
            return np.stack([self._finite_difference_slopes[2][..., part] for part in parts])[..., None]
        if name != "axial":
            return np.stack([self._finite_difference_slopes[name == "end_wrench"][..., part] for part in parts])
        revolute = np.array([joint.kind == "revolute" for joint in self.robot.joints])
        return (
            np.where(
                revolute, self._finite_difference_slopes[0][..., ABOUT], self._finite_difference_slopes[0][..., ALONG]
            )
            + self._finite_difference_slopes[3]
        )[None]

    @cached_property
    def _finite_difference_slopes(self) -> Parts:
        """Of the wrenches on joints (K, N, n, 6), ends of links and base (K, N, 6), and of what works on joints through
        linkages (K, N, n), by differences of moving loads.
        """
        count, rows, n = len(self), len(self.rows), self.robot.n_joints
        made = tuple(np.zeros((count, rows, *shape)) for shape in ((n, 6), (n, 6), (6,), (n,)))
        for k, parts in enumerate(self._each()):
            for whole, part in zip(made, parts, strict=True):
                whole[k] = part
        return made

    def _each(self) -> Iterator[Parts]:
        o = self.rows
        for k in self.bodies:
            link = self.robot.links[k]

            def load(com: Floats, link: Link = link) -> Loads:
                body = replace(link, mass=1.0, com=com, inertia=np.zeros((3, 3)))
                return joint_loads(
                    replace(self.robot, links=(body,)), o.q, qd=o.qd, qdd=o.qdd, deflection=self.deflection
                )

            yield from _of_body(load, link.com)
        if self.has_payload:
            assert o.payload_kg is not None
            bare, place = replace(self.robot, links=()), payload_place(o)
            one = np.asarray(o.payload_kg > 0.0, dtype=np.float64)

            def payload_loads(com: Floats, kg: Floats) -> Loads:
                return joint_loads(
                    bare, o.q, qd=o.qd, qdd=o.qdd, payload_kg=kg, payload_com=com, deflection=self.deflection
                )

            yield _load_components(payload_loads(place, one))
            for e in np.eye(3):
                yield _half(payload_loads(place + e, o.payload_kg), payload_loads(place - e, o.payload_kg))


def _group(name: str, part: int) -> tuple[int, ...]:
    return next(parts for parts in TOGETHER[name] if part in parts)


def links_with_mass(robot: Robot) -> tuple[int, ...]:
    """Links (from 0) that have a mass."""
    return tuple(k for k, link in enumerate(robot.links) if link.mass > 0.0)


def payload_place(o: Observations) -> Floats:
    """Stated place (N, 3) m of the payload in the tool frame."""
    return np.zeros((len(o), 3)) if o.payload_com is None else o.payload_com


def payload_sensitivity(robot: Robot, o: Observations, deflection: Deflection | None = None) -> Floats:
    """Axial load (N, n, 4) of 1 kg at the payload's place, and of 1 kg·m of first moment along tool x, y, z."""
    if not len(o):
        return np.zeros((*o.q.shape, EACH))
    one = Observations(o.q, qd=o.qd, qdd=o.qdd, payload_kg=np.ones(len(o)), payload_com=o.payload_com)
    return np.moveaxis(LoadSlopes(replace(robot, links=()), one, deflection).component_slopes("axial", 0), 0, 2)


def with_masses(robot: Robot, change: Sequence[float]) -> Robot:
    """The robot whose loads are those of ``robot`` with the link errors ``change``, as :class:`LoadSlopes` orders them."""
    links = list(robot.links)
    for n, k in enumerate(links_with_mass(robot)):
        mass, *moment = change[EACH * n : EACH * n + EACH]
        links[k] = _link_with_added_mass(links[k], mass, np.array(moment))
    return replace(robot, links=tuple(links))


def with_payload(kg: float, com: Sequence[float], change: Sequence[float]) -> tuple[float, tuple[float, ...]]:
    """Mass and place of a payload with the errors ``change`` (mass kg, shift m); nothing where nothing is carried."""
    if kg <= 0.0 or not len(change):
        return kg, tuple(com)
    whole = kg + change[0]
    shift = np.asarray(change[1:]) * kg / (whole if abs(whole) > LIGHTEST_KG else LIGHTEST_KG)
    return whole, tuple(float(c + s) for c, s in zip(com, shift, strict=True))


def _link_with_added_mass(link: Link, mass: float, moment: Floats) -> Link:
    """The inertia about the stated centre grows by the added mass only in second order, which is taken off again."""
    whole = link.mass + mass
    whole = whole if abs(whole) > LIGHTEST_KG else LIGHTEST_KG
    bend = (moment @ moment * np.eye(3) - np.outer(moment, moment)) / whole
    return replace(link, mass=whole, com=link.com + moment / whole, inertia=link.inertia - bend)


def _of_body(load: Callable[[Floats], Loads], com: Floats) -> Iterator[Parts]:
    yield _load_components(load(com))
    for e in np.eye(3):
        yield _half(load(com + e), load(com - e))


def _load_components(loads: Loads) -> Parts:
    linked = np.zeros(loads.joints.shape[:2]) if loads.linked is None else loads.linked
    return loads.joints, loads.ends, loads.base, linked


def _half(ahead: Loads, behind: Loads) -> Parts:
    """Half the difference: a body's load is quadratic in its place at most, so any width is exact."""
    one, other = _load_components(ahead), _load_components(behind)
    return tuple((a - b) / 2.0 for a, b in zip(one, other, strict=True))
