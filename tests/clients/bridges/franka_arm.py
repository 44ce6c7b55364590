"""A Franka arm whose lengths and zeros are not quite those of its model, and its kinematics, without code of Kilter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
ALPHA = np.radians([0, -90, 90, 90, -90, 90, 90])
A_MM = np.array([0, 0, 0, 82.5, -82.5, 0, 88.0])
D_MM = np.array([333.0, 0, 316.0, 0, 384.0, 0, 0])
FLANGE_MM = 107.0
HOME = np.array([0.0, 0.0, 0.0, -1.57, 0.0, 1.57, 0.785])
OFF_RAD = np.radians([0.05, -0.08, 0.06, 0.09, -0.07, 0.05, 0.0])
OFF_A_MM = np.array([0, 0, 0, 0.3, -0.2, 0, 0.2])
OFF_D_MM = np.array([0.0, 0, 0.4, 0, -0.3, 0, 0])


def tool_mm(q: Floats, real: bool = False) -> Floats:
    """Flange (N, 3) mm at joints (N, 7) rad: Rx(alpha) Tx(a) Rz(q) Tz(d) one after another."""
    off = float(real)
    angles, a, d = q + off * OFF_RAD, A_MM + off * OFF_A_MM, D_MM + off * OFF_D_MM
    point = np.tile([0.0, 0.0, FLANGE_MM], (len(q), 1))
    for k in reversed(range(7)):
        c, s = np.cos(angles[:, k]), np.sin(angles[:, k])
        x, y = c * point[:, 0] - s * point[:, 1] + a[k], s * point[:, 0] + c * point[:, 1]
        z = point[:, 2] + d[k]
        ca, sa = np.cos(ALPHA[k]), np.sin(ALPHA[k])
        point = np.stack([x, ca * y - sa * z, sa * y + ca * z], axis=1)
    return point


def table(seconds: float, rest_s: float, step_s: float = 0.001) -> Floats:
    """Setpoints (N, 8) of time and joints, s and rad: at rest, through smooth turns for so long, and at rest again."""
    t = np.arange(0.0, seconds + 2 * rest_s, step_s)
    moving = np.clip((t - rest_s) / seconds, 0.0, 1.0)
    # Time passes smoothly from rest to rest: its first two derivatives are zero at both ends.
    share = moving**3 * (10 + moving * (6 * moving - 15))
    turns = max(1, round(seconds / 8.0))
    phase = 2 * np.pi * turns * share[:, None]
    swing = np.array([0.4, 0.3, 0.25, 0.3, 0.2, 0.3, 0.2]) * np.sin(phase * np.array([1, 2, 1, 2, 1, 2, 1]))
    return np.column_stack([t, HOME + swing])


def from_path_mm(points: Floats, path: Floats) -> Floats:
    """Distance (N,) of points (N, 3) to a line through dense points (M, 3): to the pieces about its 50 nearest points."""
    begin, way = path[:-1], np.diff(path, axis=0)
    length = np.einsum("ij,ij->i", way, way) + 1e-12
    _, near = cKDTree(path).query(points, min(50, len(path)))
    found = np.full(len(points), np.inf)
    for pieces in (*near.T, *(near.T - 1)):
        pieces = np.clip(pieces, 0, len(way) - 1)
        share = np.clip(np.einsum("ij,ij->i", points - begin[pieces], way[pieces]) / length[pieces], 0.0, 1.0)
        apart = begin[pieces] + share[:, None] * way[pieces] - points
        found = np.minimum(found, np.sqrt((apart**2).sum(axis=1)))
    return found
