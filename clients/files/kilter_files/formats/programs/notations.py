"""How languages of robots write poses: numbers to a pose, and back to numbers near those that were there."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from kilter_files.ground.orientation import Quaternion, from_euler, product, upright

Point = tuple[float, float, float]


class Rigid(NamedTuple):
    """A frame seen from another: its origin in mm, and its unit quaternion w, x, y, z."""

    place: Point = (0.0, 0.0, 0.0)
    turn: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def compose_frames(self, other: Rigid) -> Rigid:
        """Return the frame ``other``, which is seen from this one."""
        x, y, z = rotate_vector(self.turn, other.place)
        place = (self.place[0] + x, self.place[1] + y, self.place[2] + z)
        return Rigid(place, upright(product(self.turn, other.turn)))

    def inverse(self) -> Rigid:
        """Return the frame from which this one is seen, seen from this one."""
        w, x, y, z = self.turn
        back = (w, -x, -y, -z)
        a, b, c = rotate_vector(back, self.place)
        return Rigid((-a, -b, -c), back)


def rotate_vector(q: Quaternion, v: Point) -> Point:
    """Return a vector rotated by a unit quaternion."""
    _, x, y, z = product(product(q, (0.0, *v)), (q[0], -q[1], -q[2], -q[3]))
    return (x, y, z)


def of_document(pose: dict[str, float]) -> Rigid:
    """Read a pose of the contract: ``x_mm`` to ``rz_deg``."""
    angles = (math.radians(pose["rz_deg"]), math.radians(pose["ry_deg"]), math.radians(pose["rx_deg"]))
    return Rigid((pose["x_mm"], pose["y_mm"], pose["z_mm"]), from_euler(angles, "ZYX"))


def to_document(pose: Rigid) -> dict[str, float]:
    """Write a pose as the contract does."""
    z, y, x = zyx(pose.turn, 0.0)
    lengths = dict(zip(("x_mm", "y_mm", "z_mm"), pose.place, strict=True))
    return lengths | {"rx_deg": math.degrees(x), "ry_deg": math.degrees(y), "rz_deg": math.degrees(z)}


def zyx(q: Quaternion, first: float) -> Point:
    """Return the angles rad about z, y and x of a rotation; at 90 degrees about y the first is the one that is given."""
    x_axis, y_axis = rotate_vector(q, (1.0, 0.0, 0.0)), rotate_vector(q, (0.0, 1.0, 0.0))
    z_axis = rotate_vector(q, (0.0, 0.0, 1.0))
    turn = math.atan2(x_axis[1], x_axis[0]) if math.hypot(x_axis[0], x_axis[1]) > 1e-12 else first
    c, s = math.cos(turn), math.sin(turn)
    # near 90 degrees about y the first angle is rounding noise: what it took off, the last gives back
    second = math.atan2(-x_axis[2], c * x_axis[0] + s * x_axis[1])
    third = math.atan2(s * z_axis[0] - c * z_axis[1], c * y_axis[1] - s * y_axis[0])
    return (turn, second, third)


def of_vector(vector: Sequence[float]) -> Quaternion:
    """Return the quaternion of a rotation vector, rad."""
    angle = math.hypot(*vector)
    share = 0.5 if angle < 1e-12 else math.sin(angle / 2) / angle
    return upright((math.cos(angle / 2), *(share * part for part in vector)))  # type: ignore[arg-type]


def to_vector(q: Quaternion) -> list[list[float]]:
    """Return the rotation vectors rad of a rotation: the one up to 180 degrees, and that the other way round."""
    w, *xyz = upright(q)
    size = math.hypot(*xyz)
    if size < 1e-15:
        return [[0.0, 0.0, 0.0]]
    angle = 2.0 * math.atan2(size, w)
    return [[part / size * turn for part in xyz] for turn in (angle, angle - 2.0 * math.pi)]


NOT_UNIT = 1e-3  # a quaternion whose length is off by more is none


@dataclass(frozen=True)
class Notation:
    """The names of the numbers, the decimals that each is written with at least, and how the last of them rotate.

    ``mm`` is how many mm a number of the place is, ``same`` how little a number of it and of the rotation may move.
    """

    names: tuple[str, ...]
    decimals: tuple[int, ...]
    mm: float
    same: tuple[float, float]
    rotation: Callable[[Sequence[float]], Quaternion]
    numbers: Callable[[Quaternion, Sequence[float]], Sequence[float]]

    def pose(self, values: Sequence[float]) -> Rigid:
        """Return the pose of these numbers."""
        x, y, z = (value * self.mm for value in values[:3])
        return Rigid((x, y, z), self.rotation(values[3:]))

    def nearest_numbers(self, pose: Rigid, old: Sequence[float]) -> list[float]:
        """Return the numbers of a pose: of all that say the same, those nearest to the old ones."""
        return [*(value / self.mm for value in pose.place), *self.numbers(pose.turn, old[3:])]

    def is_number_changed(self, k: int, old: float, new: float) -> bool:
        """Say whether number ``k`` is another one."""
        return abs(new - old) > self.same[k >= 3]


@dataclass(frozen=True)
class Frame:
    """A frame of a program, by its numbers."""

    notation: Notation
    numbers: tuple[float, ...]

    def pose(self) -> Rigid:
        """Return where it is."""
        return self.notation.pose(self.numbers)


def _of_zyx(angles: Sequence[float]) -> Quaternion:
    z, y, x = (math.radians(angle) for angle in angles)
    return from_euler((z, y, x), "ZYX")


def _to_zyx(q: Quaternion, old: Sequence[float]) -> list[float]:
    z, y, x = zyx(q, math.radians(old[0]))
    ways = [(z, y, x), (z + math.pi, math.pi - y, x + math.pi)]
    written = [
        [_nearest_equivalent_angle(math.degrees(angle), was) for angle, was in zip(way, old, strict=True)]
        for way in ways
    ]
    return min(written, key=lambda way: max(abs(new - was) for new, was in zip(way, old, strict=True)))


def _nearest_equivalent_angle(angle: float, old: float) -> float:
    """The same angle within 180 degrees of the old one."""
    return angle + 360.0 * round((old - angle) / 360.0)


def _of_xyz(angles: Sequence[float]) -> Quaternion:
    return _of_zyx(angles[::-1])


def _to_xyz(q: Quaternion, old: Sequence[float]) -> list[float]:
    return _to_zyx(q, old[::-1])[::-1]


def _to_vector(q: Quaternion, old: Sequence[float]) -> list[float]:
    return min(to_vector(q), key=lambda way: math.dist(way, old))


def _of_quaternion(q: Sequence[float]) -> Quaternion:
    return upright((q[0], q[1], q[2], q[3]))


def _to_quaternion(q: Quaternion, old: Sequence[float]) -> list[float]:
    length = math.copysign(math.hypot(*old), sum(a * b for a, b in zip(q, old, strict=True)))
    return [part * length for part in q]


KRL = Notation(("X", "Y", "Z", "A", "B", "C"), (7,) * 3 + (9,) * 3, 1.0, (1e-7, 1e-9), _of_zyx, _to_zyx)
FANUC = Notation(("X", "Y", "Z", "W", "P", "R"), (3,) * 6, 1.0, (1e-7, 1e-9), _of_xyz, _to_xyz)
RAPID = Notation(
    ("x", "y", "z", "q1", "q2", "q3", "q4"), (7,) * 3 + (11,) * 4, 1.0, (1e-7, 1e-11), _of_quaternion, _to_quaternion
)
URSCRIPT = Notation(
    ("x", "y", "z", "rx", "ry", "rz"), (10,) * 3 + (11,) * 3, 1e3, (1e-10, 1e-11), of_vector, _to_vector
)
