"""Finite rigid motions of many rows at once, as 4 x 4 matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def turn(w: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of the rotation vectors ``w (..., 3)``, by Rodrigues."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    k = np.zeros((*w.shape, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    k -= np.swapaxes(k, -1, -2)
    half = np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * half**2 * (k @ k))


def motion(p: Floats, w: Floats) -> Floats:
    """Displacement ``p (..., 3)`` and then a turn by the rotation vector ``w (..., 3)``: (..., 4, 4)."""
    out = np.zeros((*w.shape[:-1], 4, 4))
    out[..., :3, :3] = turn(w)
    out[..., :3, 3] = p
    out[..., 3, 3] = 1.0
    return out


def about_z(q: Floats) -> Floats:
    """Turns by ``q (...)`` about z: (..., 4, 4)."""
    out = np.zeros((*q.shape, 4, 4))
    c, s = np.cos(q), np.sin(q)
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    return out


def step(axis: str, amount: float) -> Floats:
    """One elementary motion ``Tx`` .. ``Rz`` by m or rad: (4, 4)."""
    six = np.zeros(6)
    six["xyz".index(axis[1]) + (3 if axis[0] == "R" else 0)] = amount
    return motion(six[:3], six[3:])


def six(values: Floats) -> Floats:
    """Small errors ``(..., 6)``, displacement m and rotation vector rad, as motions (..., 4, 4)."""
    return motion(values[..., :3], values[..., 3:])
