"""From directions to pixels, as OpenCV's models state it."""

from __future__ import annotations

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see.optics.camera import MODELS

FREE = {model: max(counts) for model, counts in MODELS.items()}  # numbers of each model


def project_points(points: Floats, intrinsics: Floats, model: str) -> Floats:
    """Pixels (..., 2) of points (..., 3) in the camera's frame; ``intrinsics`` are fx, fy, cx, cy and the lens."""
    z = np.where(np.abs(points[..., 2]) < 1e-9, 1e-9, points[..., 2])
    x, y = points[..., 0] / z, points[..., 1] / z
    x, y = _fisheye(x, y, intrinsics[4:]) if model == "fisheye" else _brown(x, y, intrinsics[4:])
    fx, fy, cx, cy = intrinsics[:4]
    return np.stack([fx * x + cx, fy * y + cy], axis=-1)


def _brown(x: Floats, y: Floats, lens: Floats) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([lens, np.zeros(8 - len(lens))])
    r2 = x**2 + y**2
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    )


def _fisheye(x: Floats, y: Floats, lens: Floats) -> tuple[Floats, Floats]:
    r = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(r)
    k1, k2, k3, k4 = lens
    a2 = angle**2
    scale = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) / r
    return x * scale, y * scale
