"""Euler angles of lab files to the contract's quaternion (w, x, y, z)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np

Quaternion = tuple[float, float, float, float]

MATRICES = ("rows", "columns")
ORTHOGONAL = 2e-3  # by which squares and products of a matrix's rows may be off: of three written digits
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


def from_matrix(parts: Sequence[float], order: str) -> Quaternion | None:
    """Return the quaternion of a rotation matrix (9), ``"rows"`` or ``"columns"`` one after the other; None if it is none."""
    a, b, c = parts[0:3], parts[3:6], parts[6:9]
    if order == "columns":
        a, b, c = tuple(zip(a, b, c, strict=True))
    if any(math.isnan(part) for part in parts):
        return (math.nan, math.nan, math.nan, math.nan)
    lengths = [_dot(x, x) - 1.0 for x in (a, b, c)]
    angles = [_dot(a, b), _dot(a, c), _dot(b, c)]
    third = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    if max(map(abs, lengths + angles)) > ORTHOGONAL or _dot(third, c) < 0.0:
        return None
    # The largest of the four parts is divided by, so that none is lost to rounding.
    squares = (a[0] + b[1] + c[2], a[0] - b[1] - c[2], b[1] - a[0] - c[2], c[2] - a[0] - b[1])
    rows = (
        (1.0 + squares[0], c[1] - b[2], a[2] - c[0], b[0] - a[1]),
        (c[1] - b[2], 1.0 + squares[1], b[0] + a[1], a[2] + c[0]),
        (a[2] - c[0], b[0] + a[1], 1.0 + squares[2], c[1] + b[2]),
        (b[0] - a[1], a[2] + c[0], c[1] + b[2], 1.0 + squares[3]),
    )
    return upright(rows[squares.index(max(squares))])


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


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


def matrices_from_quaternions(quaternions: Floats) -> Floats:
    """Return rotations (n, 3, 3) of unit quaternions (n, 4; w first)."""
    w, x, y, z = quaternions.T
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def quaternions_from_matrices(turned: Floats) -> Floats:
    """Return quaternions (n, 4; w first) of rotations, by the largest of their four squares: exact near any angle."""
    m = turned.reshape(-1, 9).T
    squares = np.stack([1 + m[0] + m[4] + m[8], 1 + m[0] - m[4] - m[8], 1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8]])
    w, x, y, z = squares
    a, b, c = m[7] - m[5], m[2] - m[6], m[3] - m[1]
    d, e, f = m[1] + m[3], m[2] + m[6], m[5] + m[7]
    sets = np.stack([np.stack([w, a, b, c]), np.stack([a, x, d, e]), np.stack([b, d, y, f]), np.stack([c, e, f, z])])
    best = np.argmax(np.nan_to_num(squares), axis=0)
    q = sets[best, :, np.arange(len(turned))]
    q = q / np.linalg.norm(q, axis=1)[:, None]
    return np.asarray(np.where(q[:, :1] < 0, -q, q))
