"""What gets mixed up between a robot's file and a measurement: order, sign, unit, zero of joints; unit, hand of points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kilter_core.arm.conversions.tables import screws_of_chain
from kilter_core.arm.robot import Robot
from kilter_core.parameters import DEG, MM
from kilter_core.transforms import inverses
from kilter_core.types import Floats, Ints

# What the values were, what they were declared as, and what converts them to what they were.
LENGTHS = (
    ("millimetres", "metres", 1e-3),
    ("metres", "millimetres", 1e3),
    ("inches", "metres", 0.0254),
    ("metres", "inches", 1.0 / 0.0254),
    ("inches", "millimetres", 25.4),
    ("millimetres", "inches", 1.0 / 25.4),
    ("centimetres", "metres", 1e-2),
    ("centimetres", "millimetres", 10.0),
)
COLUMNS = "the columns, or their names in the column map,"
PARALLEL = 0.999  # cosine of the angle of two axes that are
JOIN = "join joints and measurements by pose number or time again, and upload again"


def _make_row_shift(by: int) -> Callable[[int], Ints]:
    return lambda count: (np.arange(count) + by) % count


def _as_text(count: int) -> Ints:
    """Rows from 1 in the order of their numbers as text: 1, 10, 11, 2."""
    return np.array(sorted(range(count), key=lambda row: str(row + 1)), dtype=np.int64)


# Rows whose joints belong to a measurement: what it looks like, the remedy, and the row (N,) of every row.
ELSEWHERE: dict[str, tuple[str, str, Callable[[int], Ints]]] = {
    **{
        f"{steps:+d}": (
            f"Each measurement looks to be of the joints {abs(steps) if abs(steps) > 1 else 'one'} row"
            f"{'s' * (abs(steps) > 1)} {'above' if steps < 0 else 'below'}",
            JOIN,
            _make_row_shift(steps),
        )
        for steps in (-1, 1, -2, 2, -3, 3)
    },
    "backwards": (
        "Joints and measurements look to be in opposite order of rows",
        "reverse one of them, and upload again",
        lambda count: np.arange(count)[::-1],
    ),
    "joints as text": (
        "The joints look sorted by their numbers as text (1, 10, 11, 2), the measurements by number",
        "sort both by number, and upload again",
        lambda count: np.argsort(_as_text(count)),
    ),
    "points as text": (
        "The measurements look sorted by their numbers as text (1, 10, 11, 2), the joints by number",
        "sort both by number, and upload again",
        _as_text,
    ),
}


@dataclass(frozen=True)
class MixUp:
    """One mix-up, what to do about it, and how to read the rows without it.

    The reading is: take the joints of another row (``rows`` of :data:`ELSEWHERE`), in this ``order``, in the units they
    have on the wire, times ``factor (n,)``, plus ``coupling (n, n)`` times themselves, plus ``offset (n,)``; points times
    ``length``, one coordinate with the other sign if ``mirror``; poses ``inverted``, which needs rotations.
    """

    sentence: str
    remedy: str
    order: tuple[int, ...] | None = None
    factor: Floats | None = None
    offset: Floats | None = None
    coupling: Floats | None = None
    length: float = 1.0
    mirror: bool = False
    inverted: bool = False
    rows: str = ""
    of_units: bool = False  # of joints

    def joints(self, q: Floats, unit: Floats) -> Floats:
        """Joint readings (N, n) as they were meant; ``unit (n,)`` converts rad and m to degrees and mm."""
        if self.order is not None:
            q = (q * unit)[:, list(self.order)] / unit
        if self.factor is not None:
            q = q * self.factor
        if self.coupling is not None:
            q = q + q @ self.coupling.T
        return q if self.offset is None else q + self.offset

    def poses(self, points: Floats, rotations: Floats | None) -> tuple[Floats, Floats | None]:
        """Points (N, 3) and, where measured, rotations (N, 3, 3) as they were meant."""
        if self.inverted and rotations is not None:
            points, rotations = inverses(points, rotations)
        hand = np.diag([1.0, 1.0, -1.0]) if self.mirror else np.eye(3)
        return self.length * points @ hand, None if rotations is None else np.asarray(hand @ rotations @ hand)


def wire_units(robot: Robot) -> Floats:
    """Factors (n,) from rad and m to the degrees and mm that joints are sent in."""
    return np.array([DEG if j.kind == "revolute" else MM for j in robot.joints])


def mix_ups(robot: Robot) -> Iterator[MixUp]:
    """Every mix-up that is looked for on its own."""
    yield from _orders(robot.n_joints)
    yield from _signs(robot.n_joints)
    yield from _units(robot)
    yield from _zeros(robot)
    yield from _couplings(robot)
    for was, declared, factor in LENGTHS:
        ratio = max(factor, 1.0 / factor)
        yield MixUp(
            f"Positions look like {was} declared as {declared} (factor {ratio:.6g})",
            f"give the columns, or the column map, the unit {was}; or correct the lengths of the robot",
            length=factor,
        )
    yield MixUp(
        "The positions look left-handed: two coordinates are exchanged, or one has the other sign",
        f"correct {COLUMNS} and upload again",
        mirror=True,
    )
    yield MixUp(
        "The poses look inverted: the reference in the frame of the tool, in place of the tool in that of the reference",
        "invert each pose (position and orientation), and upload again",
        inverted=True,
    )
    for name, (sentence, remedy, _) in ELSEWHERE.items():
        yield MixUp(sentence, remedy, rows=name)


def _orders(n: int) -> Iterator[MixUp]:
    known = {tuple(range(n))}
    for i, j in combinations(range(n), 2):
        order = list(range(n))
        order[i], order[j] = j, i
        known.add(tuple(order))
        yield MixUp(f"Joints {i + 1} and {j + 1} look swapped", f"swap {COLUMNS} and upload again", order=tuple(order))
    # Shifted by one in the file means that the column of each joint holds the one after it.
    others = [("The joints look to be in reverse order", tuple(reversed(range(n))))]
    for k in range(1, n):
        order = [(j + k) % n for j in range(n)]
        held = ", ".join(str((order.index(c)) + 1) for c in range(n))
        others.append((f"The columns of joints 1 to {n} look to hold joints {held}", tuple(order)))
    for sentence, whole in others:
        if whole not in known:
            known.add(whole)
            yield MixUp(sentence, f"put {COLUMNS} in the robot's order and upload again", order=whole)


def _signs(n: int) -> Iterator[MixUp]:
    for j in range(n):
        yield MixUp(
            f"Joint {j + 1} looks to count the other way round",
            f"change the sign of the column of joint {j + 1}, or reverse its axis in the robot (ratio -1)",
            factor=_per_joint_values(n, [j], -1.0),
        )
    yield MixUp(
        "All joints look to count the other way round", "change the sign of their columns", factor=np.full(n, -1.0)
    )


def _units(robot: Robot) -> Iterator[MixUp]:
    n = robot.n_joints
    revolute = [j for j in range(n) if robot.joints[j].kind == "revolute"]
    groups = [([j], f"Joint {j + 1} looks") for j in revolute]
    groups += (
        [(revolute, "Joints look" if len(revolute) == n else "The revolute joints look")] if len(revolute) > 1 else []
    )
    for which, who in groups:
        for was, declared, factor in (("radians", "degrees", DEG), ("degrees", "radians", 1.0 / DEG)):
            yield MixUp(
                f"{who} like {was} declared as {declared}",
                f"give the columns, or the column map, the unit {was}",
                factor=_per_joint_values(n, which, factor),
                of_units=True,
            )
    for j in set(range(n)) - set(revolute):
        for was, declared, factor in LENGTHS[:2]:
            yield MixUp(
                f"Joint {j + 1} looks like {was} declared as {declared}",
                f"give its column the unit {was}",
                factor=_per_joint_values(n, [j], factor),
                of_units=True,
            )


def _zeros(robot: Robot) -> Iterator[MixUp]:
    n = robot.n_joints
    for j in range(n):
        for degrees in (90, -90, 180) if robot.joints[j].kind == "revolute" else ():
            yield MixUp(
                f"The zero of joint {j + 1} looks {degrees} degrees off",
                f"add {degrees} degrees to the column of joint {j + 1}, or to its offset in the robot (DH and MDH differ)",
                offset=_per_joint_values(n, [j], np.radians(degrees), 0.0),
            )


def _couplings(robot: Robot) -> Iterator[MixUp]:
    """Joints read with the motion of the joint before: against the horizontal as FANUC's J3, or behind coupled gears."""
    n, axes = robot.n_joints, _directions(robot)
    for j in range(1, n):
        if not robot.joints[j - 1].kind == robot.joints[j].kind == "revolute":
            continue
        for sign in (1.0, -1.0):
            coupling = np.zeros((n, n))
            coupling[j, j - 1] = sign
            read, undone = ("minus", "plus") if sign > 0 else ("plus", "minus")
            sentence = f"Joint {j + 1} looks read as joint {j + 1} {read} joint {j}, "
            remedy = f"upload joint {j + 1} {undone} joint {j} in its column"
            if sign * (axes[j] @ axes[j - 1]) < -PARALLEL:
                names = f"{robot.joints[j].name}={robot.joints[j - 1].name}"
                follows = f"{remedy}, or add the robot again with --follows {names}"
                yield MixUp(f"{sentence}against the horizontal (as FANUC's J3)", follows, coupling=coupling)
            else:
                yield MixUp(f"{sentence}as through coupled gears", remedy, coupling=coupling)


def _directions(robot: Robot) -> Floats:
    """Vectors (n, 3) about which the joints' own axes rotate, as they count, all joints at zero."""
    screws = screws_of_chain(robot.chain)
    moving = [k for k, e in enumerate(robot.chain.elements) if e.joint is not None]
    return (screws.direction * screws.ratio[:, None])[[moving.index(k) for k in robot.chain.primary]]


def _per_joint_values(n: int, joints: list[int], value: float, rest: float = 1.0) -> Floats:
    out = np.full(n, rest)
    out[joints] = value
    return out
