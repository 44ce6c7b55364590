"""Poses of frames in plain Python: a place in mm and a quaternion."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
