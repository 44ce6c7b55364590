"""How loads follow errors of the masses: of the links and of the payload. A load is linear in mass and first moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.moments import Loads, joint_loads
from core.observations import Observations
from core.robot import Link, Robot

Floats = NDArray[np.float64]

EACH = 4  # numbers of a body: mass, then three of its place
LIGHTEST_KG = 1e-9
NO_COLUMNS = (-1,) * EACH  # of a body that these rows do not have


@dataclass(frozen=True)
class LoadSlopes:
    """Derivatives of the loads of N rows by K load errors, four of each link that has a mass and four of the payload.

    Of a link: mass at its stated centre, kg, and first moment beyond, kg m, along the axes of its frame. Of the payload,
    in rows that carry one: mass at its stated place, kg, and shift of that place along the axes of the tool, m. Nothing
    is computed before it is read. Products of two errors are left out, so the loads are linear in them.
    """

    robot: Robot
    rows: Observations

    @cached_property
    def bodies(self) -> tuple[int, ...]:
        """Links (from 0) that have a mass; their errors come first."""
        return weighed(self.robot)

    @cached_property
    def loaded(self) -> bool:
        """Whether any row carries a payload."""
        kg = self.rows.payload_kg
        return kg is not None and bool(np.any(kg > 0.0))

    def part(self, rows: slice) -> LoadSlopes:
        """The same of some of the rows, as views of what was computed for all."""
        out = replace(self, rows=self.rows.select(rows))
        made = {"bodies": self.bodies, "loaded": self.loaded, "moments": self.moments[:, rows]}
        out.__dict__.update(made, _all=tuple(a[:, rows] for a in self._all))
        return out

    def __len__(self) -> int:
        return EACH * (len(self.bodies) + self.loaded)

    @property
    def payload(self) -> tuple[int, ...]:
        """Columns of the payload; none without one."""
        return tuple(range(EACH * len(self.bodies), len(self)))

    @cached_property
    def revolute(self) -> NDArray[np.bool_]:
        """Joints (n,) that turn."""
        return np.array([joint.kind == "revolute" for joint in self.robot.joints])

    @property
    def joints(self) -> Floats:
        """Of the wrench on each joint, (K, N, n, 6)."""
        return self._all[0]

    @property
    def ends(self) -> Floats:
        """Of the wrench on the end of each link, (K, N, n, 6)."""
        return self._all[1]

    @property
    def base(self) -> Floats:
        """Of the wrench on the base, (K, N, 6)."""
        return self._all[2]

    @cached_property
    def moments(self) -> Floats:
        """Of the moment across (x, y) each joint, and of the load that works on it, (K, N, n, 3)."""
        about = np.where(self.revolute, self.joints[..., 5], self.joints[..., 2])
        return np.concatenate([self.joints[..., 3:5], about[..., None]], axis=-1)

    def of(self, name: str, part: int) -> Floats:
        """Of a component of the loads as a batch names them, (K, N, n); of the base's (K, N)."""
        if name == "axial":
            return self.moments[..., 2]
        return {"wrench": self.joints, "end_wrench": self.ends, "base_wrench": self.base}[name][..., part]

    @cached_property
    def _all(self) -> tuple[Floats, Floats, Floats]:
        count, rows, n = len(self), len(self.rows), self.robot.n_joints
        made = np.zeros((count, rows, n, 6)), np.zeros((count, rows, n, 6)), np.zeros((count, rows, 6))
        for k, parts in enumerate(self._each()):
            for whole, part in zip(made, parts, strict=True):
                whole[k] = part
        return made

    def _each(self) -> Iterator[tuple[Floats, Floats, Floats]]:
        o = self.rows
        for k in self.bodies:
            link = self.robot.links[k]

            def load(com: Floats, link: Link = link) -> Loads:
                body = replace(link, mass=1.0, com=com, inertia=np.zeros((3, 3)))
                return joint_loads(replace(self.robot, links=(body,)), o.q, qd=o.qd, qdd=o.qdd)

            yield from _of_body(load, link.com)
        if self.loaded:
            assert o.payload_kg is not None
            bare, place = replace(self.robot, links=()), payload_place(o)
            one = np.asarray(o.payload_kg > 0.0, dtype=np.float64)

            def carried(com: Floats, kg: Floats) -> Loads:
                return joint_loads(bare, o.q, qd=o.qd, qdd=o.qdd, payload_kg=kg, payload_com=com)

            yield _parts(carried(place, one))
            for e in np.eye(3):
                yield _half(carried(place + e, o.payload_kg), carried(place - e, o.payload_kg))


def weighed(robot: Robot) -> tuple[int, ...]:
    """Links (from 0) that have a mass."""
    return tuple(k for k, link in enumerate(robot.links) if link.mass > 0.0)


def payload_place(o: Observations) -> Floats:
    """Stated place (N, 3) m of the payload in the tool frame."""
    return np.zeros((len(o), 3)) if o.payload_com is None else o.payload_com


def with_masses(robot: Robot, change: Sequence[float]) -> Robot:
    """The robot whose loads are those of ``robot`` with the link errors ``change``, as :class:`LoadSlopes` orders them."""
    links = list(robot.links)
    for n, k in enumerate(weighed(robot)):
        mass, *moment = change[EACH * n : EACH * n + EACH]
        links[k] = _changed(links[k], mass, np.array(moment))
    return replace(robot, links=tuple(links))


def with_payload(kg: float, com: Sequence[float], change: Sequence[float]) -> tuple[float, tuple[float, ...]]:
    """Mass and place of a payload with the errors ``change`` (mass kg, shift m); nothing where nothing is carried."""
    if kg <= 0.0 or not len(change):
        return kg, tuple(com)
    whole = kg + change[0]
    shift = np.asarray(change[1:]) * kg / (whole if abs(whole) > LIGHTEST_KG else LIGHTEST_KG)
    return whole, tuple(float(c + s) for c, s in zip(com, shift, strict=True))


def _changed(link: Link, mass: float, moment: Floats) -> Link:
    """The inertia about the stated centre grows by the added mass only in second order, which is taken off again."""
    whole = link.mass + mass
    whole = whole if abs(whole) > LIGHTEST_KG else LIGHTEST_KG
    bend = (moment @ moment * np.eye(3) - np.outer(moment, moment)) / whole
    return replace(link, mass=whole, com=link.com + moment / whole, inertia=link.inertia - bend)


def _of_body(load: Callable[[Floats], Loads], com: Floats) -> Iterator[tuple[Floats, Floats, Floats]]:
    yield _parts(load(com))
    for e in np.eye(3):
        yield _half(load(com + e), load(com - e))


def _parts(loads: Loads) -> tuple[Floats, Floats, Floats]:
    return loads.joints, loads.ends, loads.base


def _half(ahead: Loads, behind: Loads) -> tuple[Floats, Floats, Floats]:
    """Half the difference: a body's load is quadratic in its place at most, so any width is exact."""
    one, other = _parts(ahead), _parts(behind)
    return (one[0] - other[0]) / 2.0, (one[1] - other[1]) / 2.0, (one[2] - other[2]) / 2.0
