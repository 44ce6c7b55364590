"""How a camera maps points before it to pixels, with exact derivatives: pinhole, Brown, rational and fisheye, as OpenCV."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kilter_core.types import Floats

UNDISTORTING = 30
SETTLED = 1e-13
AXIS = 1e-9  # distance from the optical axis below which a fisheye's direction is that of a pinhole


class Seen(NamedTuple):
    """Pixels (..., 2) of points, their derivatives by the points (..., 2, 3) and by the intrinsics (..., 2, K)."""

    pixels: Floats
    by_point: Floats
    by_intrinsics: Floats


def project(model: str, intrinsics: Floats, points: Floats) -> Seen:
    """Pixels of ``points (..., 3)`` m in the camera's frame, z ahead, with ``intrinsics`` fx, fy, cx, cy, distortion.

    Points behind the camera have pixels NaN.
    """
    a, b, z = _ahead(points)
    flat, by_ab, by_d = (_fisheye if model == "fisheye" else _radial)(a, b, intrinsics[4:], by_distortion=True)
    focal = intrinsics[:2]
    by_intrinsics = np.zeros((*a.shape, 2, len(intrinsics)))
    for k in range(2):
        by_intrinsics[..., k, k] = flat[..., k]
        by_intrinsics[..., k, 2 + k] = 1.0
    by_intrinsics[..., 4:] = focal[:, None] * by_d
    return Seen(flat * focal + intrinsics[2:4], _by_point(by_ab, a, b, z, focal), by_intrinsics)


def project_held(model: str, intrinsics: Floats, points: Floats) -> tuple[Floats, Floats]:
    """As :func:`project` for a lens that is known: pixels (..., 2), and how they follow the points (..., 2, 3)."""
    a, b, z = _ahead(points)
    flat, by_ab, _ = (_fisheye if model == "fisheye" else _radial)(a, b, intrinsics[4:])
    return flat * intrinsics[:2] + intrinsics[2:4], _by_point(by_ab, a, b, z, intrinsics[:2])


def _ahead(points: Floats) -> tuple[Floats, Floats, Floats]:
    """x/z, y/z and z of points (..., 3); NaN behind the camera."""
    z = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
    return points[..., 0] / z, points[..., 1] / z, z


def _by_point(by_ab: Floats, a: Floats, b: Floats, z: Floats, focal: Floats) -> Floats:
    """How pixels follow points (..., 2, 3): written out, for a product of small matrices costs ten times as much."""
    out = np.empty((*a.shape, 2, 3))
    for k in range(2):
        x, y = (focal[k] * by_ab[..., k, i] / z for i in range(2))
        out[..., k, 0], out[..., k, 1], out[..., k, 2] = x, y, -(x * a + y * b)
    return out


def undistort_pixels(model: str, intrinsics: Floats, pixels: Floats) -> Floats:
    """Directions (..., 2), x/z and y/z, that are seen at ``pixels (..., 2)``: distortion undone by Newton's method."""
    flat = (pixels - intrinsics[2:4]) / intrinsics[:2]
    if model == "none":
        return np.asarray(flat)
    found = flat.copy()
    for _ in range(UNDISTORTING):
        here, by_ab, _ = (_fisheye if model == "fisheye" else _radial)(found[..., 0], found[..., 1], intrinsics[4:])
        step = _solve_2x2(by_ab, flat - here)
        size = np.linalg.norm(step, axis=-1, keepdims=True)
        found = found + step * np.minimum(1.0, 0.5 / np.maximum(size, 0.5))
        if np.nanmax(size, initial=0.0) < SETTLED:
            break
    return found


def _solve_2x2(M: Floats, v: Floats) -> Floats:
    determinant = M[..., 0, 0] * M[..., 1, 1] - M[..., 0, 1] * M[..., 1, 0]
    x = M[..., 1, 1] * v[..., 0] - M[..., 0, 1] * v[..., 1]
    y = M[..., 0, 0] * v[..., 1] - M[..., 1, 0] * v[..., 0]
    return np.asarray(np.stack([x, y], -1) / determinant[..., None])


def _radial(a: Floats, b: Floats, d: Floats, *, by_distortion: bool = False) -> tuple[Floats, Floats, Floats]:
    """Distorted directions (..., 2) and their derivatives by the directions (..., 2, 2) and, where they are asked for, by
    the distortion (..., 2, D).
    """
    if not len(d):
        eye = np.broadcast_to(np.eye(2), (*a.shape, 2, 2))
        return np.stack([a, b], -1), eye, np.zeros((*a.shape, 2, 0))
    k = np.zeros(8)
    k[: len(d)] = d
    s = a * a + b * b
    above, below = 1.0 + s * (k[0] + s * (k[1] + s * k[4])), 1.0 + s * (k[5] + s * (k[6] + s * k[7]))
    g = above / below
    slope = (k[0] + s * (2.0 * k[1] + 3.0 * s * k[4])) / below
    slope = slope - g * (k[5] + s * (2.0 * k[6] + 3.0 * s * k[7])) / below  # of g by s
    p1, p2 = k[2], k[3]
    across = a * g + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a)
    flat = np.stack([across, b * g + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b], -1)
    cross = 2.0 * a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
    first = g + 2.0 * a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
    last = g + 2.0 * b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
    by_ab = np.stack([first, cross, cross, last], -1).reshape(*a.shape, 2, 2)
    if not by_distortion:
        return flat, by_ab, np.zeros((*a.shape, 2, 0))
    point = np.stack([a, b], -1)
    powers = {0: s, 1: s**2, 4: s**3} | ({5: -g * s, 6: -g * s**2, 7: -g * s**3} if len(d) > 5 else {})
    by_d = np.empty((*a.shape, 2, len(d)))
    for c, power in powers.items():
        if c < len(d):
            by_d[..., c] = point * (power / below)[..., None]
    by_d[..., 2] = np.stack([2.0 * a * b, s + 2.0 * b * b], -1)
    by_d[..., 3] = np.stack([s + 2.0 * a * a, 2.0 * a * b], -1)
    return flat, by_ab, by_d


def _fisheye(a: Floats, b: Floats, d: Floats, *, by_distortion: bool = False) -> tuple[Floats, Floats, Floats]:
    """As :func:`_radial`, of the equidistant model of Kannala and Brandt."""
    r = np.hypot(a, b)
    safe = np.maximum(r, AXIS)
    t = np.arctan(safe)
    powers = np.stack([t**3, t**5, t**7, t**9], -1)
    bent = t + powers @ d
    bent_by_t = 1.0 + np.stack([3.0 * t**2, 5.0 * t**4, 7.0 * t**6, 9.0 * t**8], -1) @ d
    g = bent / safe
    slope = (bent_by_t / (1.0 + safe**2) - g) / safe**2  # of g by r, over r
    point = np.stack([a, b], -1)
    by_ab = g[..., None, None] * np.eye(2) + slope[..., None, None] * point[..., :, None] * point[..., None, :]
    by_d = (
        point[..., :, None] * (powers / safe[..., None])[..., None, :] if by_distortion else np.zeros((*a.shape, 2, 0))
    )
    return point * g[..., None], by_ab, by_d
