"""A kinematic chain: elementary transforms in a row, some driven by joints, most of them nameable parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from kilter_core.errors import RobotError
from kilter_core.parameters import ANGLE_PRIOR_RAD, LENGTH_PRIOR_M, Parameter, refuse_collisions
from kilter_core.transforms import rotation_along
from kilter_core.types import Floats, Ints


class Axis(IntEnum):
    """Elementary motions; the numbers are the codes of the kernels."""

    TX = 0
    TY = 1
    TZ = 2
    RX = 3
    RY = 4
    RZ = 5

    @property
    def rotates(self) -> bool:
        """Whether the motion is a rotation."""
        return self >= Axis.RX

    def motion(self, amount: float) -> Floats:
        """Pose (4, 4) of the motion by ``amount``, rad or m."""
        out = np.eye(4)
        if self.rotates:
            out[:3, :3] = rotation_along(self % 3, amount)
        else:
            out[self % 3, 3] = amount
        return out


# Who carries the load on an axis that follows a joint: the gear of that joint too (rods of a parallelogram, by virtual
# work), the motor that the controller moves along, or gears of its own in series.
LINKAGE, CONTROLLER, SERIES = DRIVES = ("linkage", "controller", "series")


@dataclass(frozen=True)
class Element:
    """One elementary transform.

    ``value`` (m or rad) is the constant, for a joint element its zero offset. A joint element moves by
    ``ratio * q[joint] + value``; a ratio of -1 reverses the axis, others couple joints (mimic, FANUC J2/J3).
    ``name`` makes the constant a parameter; without a name it is part of the structure. A ``dependent`` parameter says what
    others of a complete model say together: it is identified at level 1 or when it is asked for, not beside them.
    ``drive`` says who carries the load on a further axis of a joint, one of :data:`DRIVES`; None: nobody said.
    """

    axis: Axis
    value: float = 0.0
    name: str | None = None
    joint: int | None = None
    ratio: float = 1.0
    dependent: bool = False
    drive: str | None = None

    def parameter(self) -> Parameter:
        """The named constant as a :class:`~kilter_core.parameters.Parameter`."""
        if self.axis.rotates:
            return Parameter(self.name or "", "rad", self.value, ANGLE_PRIOR_RAD)
        return Parameter(self.name or "", "m", self.value, LENGTH_PRIOR_M)


@dataclass(frozen=True)
class Program:
    """The chain as arrays for the kernels; shapes (E,) and, for the joints, (n,)."""

    axis: Ints
    joint: Ints
    ratio: Floats
    value: Floats
    primary: Ints
    joint_frame: Floats


@dataclass(frozen=True)
class Chain:
    """Elements from the base frame to the flange, and the number of joints that drive them."""

    elements: tuple[Element, ...]
    n_joints: int

    def __post_init__(self) -> None:
        refuse_collisions([e.name for e in self.elements if e.name])
        driven = {e.joint for e in self.elements if e.joint is not None}
        missing = sorted(set(range(self.n_joints)) - driven)
        if missing:
            raise RobotError(
                f"No element of the chain is driven by joint {missing[0] + 1}: add one, or drop the joint.",
                joint=missing[0] + 1,
            )
        self._check_drives()

    def _check_drives(self) -> None:
        for k, e in enumerate(self.elements):
            if e.drive is not None and e.drive not in DRIVES:
                raise RobotError(f"drive is {e.drive!r}: give {', '.join(DRIVES)}.", field=f"elements[{k}].drive")
            if e.drive is not None and k not in self.followers:
                raise RobotError(
                    f"elements[{k}] has drive {e.drive!r}, which says who carries the load on a further axis of a joint "
                    "(mimic, parallelogram): leave it out where a joint moves its own axis, or none.",
                    field=f"elements[{k}].drive",
                )

    @cached_property
    def primary(self) -> tuple[int, ...]:
        """Element of each joint: the one with ratio ±1 when there is one, else its first."""
        out = []
        for j in range(self.n_joints):
            own = [k for k, e in enumerate(self.elements) if e.joint == j]
            out.append(next((k for k in own if abs(self.elements[k].ratio) == 1.0), own[0]))
        return tuple(out)

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Elements that joints move: the moving axes, from the base on. A joint may drive several."""
        return tuple(k for k, e in enumerate(self.elements) if e.joint is not None)

    @cached_property
    def followers(self) -> tuple[int, ...]:
        """Moving axes that are not a joint's own: they follow it (mimic, parallelogram)."""
        return tuple(k for k in self.driven if k not in self.primary)

    @cached_property
    def linkage_axes(self) -> tuple[int, ...]:
        """Axes that follow a joint by a linkage, so that its gear carries their load too."""
        return tuple(k for k in self.followers if self.elements[k].drive == LINKAGE)

    def linkage_load_ratio(self, element: int) -> float:
        """How far a linked axis moves per motion of its joint's own axis: what of its load that joint carries."""
        own = self.elements[self.primary[self.elements[element].joint or 0]]
        return self.elements[element].ratio / abs(own.ratio)

    @cached_property
    def named_elements(self) -> tuple[int, ...]:
        """Indices of the elements that carry a parameter."""
        return tuple(k for k, e in enumerate(self.elements) if e.name)

    @cached_property
    def link_vectors(self) -> Floats:
        """Vector (n + 1, 3) m of each link, from its joint's origin to the next joint's, in its joint frame.

        Row n is the base's, from the base frame to the first joint; the last link ends at the flange. Constants between
        two joints only, at their nominal values.
        """
        out = np.zeros((self.n_joints + 1, 3))
        for j, start, _, _, reach in self._links():
            out[j] = reach if start < 0 else _joint_frame(self.elements[start]).T @ reach
        return out

    @cached_property
    def next_axes(self) -> Floats:
        """Direction (n, 3) of the next joint's axis in each joint frame, constants between the two only; 0 for the last."""
        out = np.zeros((self.n_joints, 3))
        for j, start, end, turn, _ in self._links():
            if start >= 0 and end < len(self.elements):
                out[j] = _joint_frame(self.elements[start]).T @ turn @ _joint_frame(self.elements[end])[:, 2]
        return out

    def _links(self) -> Iterator[tuple[int, int, int, Floats, Floats]]:
        """Each joint (n: the base) with its element, the next joint's, and from one to the other: rotation, and way."""
        starts = [(-1, self.n_joints), *sorted((k, j) for j, k in enumerate(self.primary))]
        ends = [k for k, _ in starts[1:]] + [len(self.elements)]
        for (start, j), end in zip(starts, ends, strict=True):
            turn, reach = np.eye(3), np.zeros(3)
            for e in self.elements[start + 1 : end]:
                k = e.axis % 3
                if not e.axis.rotates:
                    reach = reach + turn[:, k] * e.value
                elif e.joint is None:
                    turn = turn @ rotation_along(k, e.value)
            yield j, start, end, turn, reach

    @cached_property
    def program(self) -> Program:
        """The chain as kernel arrays."""
        es = self.elements
        return Program(
            axis=np.array([e.axis for e in es], dtype=np.int64),
            joint=np.array([-1 if e.joint is None else e.joint for e in es], dtype=np.int64),
            ratio=np.array([e.ratio for e in es], dtype=np.float64),
            value=np.array([e.value for e in es], dtype=np.float64),
            primary=np.array(self.primary, dtype=np.int64),
            joint_frame=np.stack([_joint_frame(es[k]) for k in self.primary]),
        )


def axis_frame(axis: Axis) -> Floats:
    """Rotation (3, 3) from the frame after an element to one whose z is its axis, x and y in cyclic order."""
    z = axis % 3
    frame = np.zeros((3, 3))
    for column, row in enumerate(((z + 1) % 3, (z + 2) % 3, z)):
        frame[row, column] = 1.0
    return frame


def _joint_frame(element: Element) -> Floats:
    """Rotation (3, 3) from the frame after a joint's element to the joint frame, whose z is the positive joint axis."""
    frame = axis_frame(element.axis)
    if element.ratio < 0:
        frame = frame @ np.diag([1.0, -1.0, -1.0])
    return frame


FRAME_AXES = ((Axis.TX, "x"), (Axis.TY, "y"), (Axis.TZ, "z"), (Axis.RX, "rx"), (Axis.RY, "ry"), (Axis.RZ, "rz"))


# Base and tool frames are found from scratch by the registration; these widths only keep an unobservable direction finite.
FRAME_LENGTH_PRIOR_M = 0.1


FRAME_ANGLE_PRIOR_RAD = 0.3


def frame_parameters(which: str) -> list[Parameter]:
    """Six increments of the ``which`` frame, named ``<which>_x`` to ``<which>_rz``."""
    return [
        Parameter(
            f"{which}_{name}",
            "rad" if axis.rotates else "m",
            0.0,
            FRAME_ANGLE_PRIOR_RAD if axis.rotates else FRAME_LENGTH_PRIOR_M,
            description=f"increment of the {which} frame in its own axes",
        )
        for axis, name in FRAME_AXES
    ]


def increment(six: Floats) -> Floats:
    """Tx Ty Tz Rx Ry Rz of six increments as a pose (4, 4)."""
    T = np.eye(4)
    for (axis, _), amount in zip(FRAME_AXES, six, strict=True):
        T = T @ axis.motion(amount)
    return T
