"""Rotation matrices and quaternions (w first), many at once."""

from __future__ import annotations

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np


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
