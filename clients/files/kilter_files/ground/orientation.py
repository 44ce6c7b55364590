"""Euler angles of lab files to the contract's quaternion (w, x, y, z)."""

from __future__ import annotations

import math
import re

Quaternion = tuple[float, float, float, float]

SEQUENCE = re.compile(r"[xyz]{3}|[XYZ]{3}")


def is_sequence(name: str) -> bool:
    """Tell whether ``name`` is an Euler convention: capitals for the moving axes, small letters for the fixed."""
    return bool(SEQUENCE.fullmatch(name)) and name[0] != name[1] and name[1] != name[2]


def from_euler(angles: tuple[float, float, float], sequence: str) -> Quaternion:
    """Return the quaternion of three angles [rad]: ``"XYZ"`` intrinsic, ``"xyz"`` extrinsic, as scipy writes them."""
    turns = [_about(axis, angle) for axis, angle in zip(sequence.upper(), angles, strict=True)]
    if sequence.islower():
        turns.reverse()
    return upright(product(product(turns[0], turns[1]), turns[2]))


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion of the rotation ``b`` in the frame rotated by ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def upright(q: Quaternion) -> Quaternion:
    """Return ``q`` at unit length with w >= 0: one orientation, one quaternion."""
    size = math.sqrt(sum(part * part for part in q))
    size = -size if q[0] < 0 else size
    return (q[0] / size, q[1] / size, q[2] / size, q[3] / size)


def _about(axis: str, angle: float) -> Quaternion:
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    return (c, s if axis == "X" else 0.0, s if axis == "Y" else 0.0, s if axis == "Z" else 0.0)
