"""From pixels to mm on the sheet: a homography, and one coefficient of a lens that bends straight lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kilter_files.ground.arrays import Floats

FLOOR_MM = 0.01  # nobody prints and finds marks better
TURNS = 9  # of the fixed point that undoes the lens


@dataclass(frozen=True)
class Camera:
    """``values``: eight of the homography from scaled pixels to mm, then the lens; ``covariance`` (9, 9) of them."""

    centre: Floats
    half: float
    values: Floats
    covariance: Floats

    def to_mm(self, pixels: Floats) -> Floats:
        """Return mm on the sheet (n, 2) of pixels (n, 2)."""
        return _project(self.values, (pixels - self.centre) / self.half)

    def to_pixels(self, mm: Floats) -> Floats:
        """Return the pixels (n, 2) of points on the sheet (n, 2) in mm."""
        inverse = np.linalg.inv(np.append(self.values[:8], 1.0).reshape(3, 3))
        flat = _apply(inverse, mm)
        bent = flat
        for _ in range(TURNS if self.lens else 0):
            bent = flat / (1.0 + self.lens * np.einsum("ij,ij->i", bent, bent))[:, None]
        return np.asarray(bent * self.half + self.centre)

    @property
    def lens(self) -> float:
        """How much of the half diagonal's length the corner of the picture is bent."""
        return float(self.values[8])

    @property
    def lens_sigma(self) -> float:
        """Its standard deviation, 0 when it was not looked for."""
        return float(np.sqrt(self.covariance[8, 8]))

    def px_per_mm(self, at_mm: Floats) -> Floats:
        """Return the least pixels per mm, over directions, at points (n, 2)."""
        step = 0.5
        here = self.to_pixels(at_mm)
        dx = (self.to_pixels(at_mm + np.array([step, 0.0])) - here) / step
        dy = (self.to_pixels(at_mm + np.array([0.0, step])) - here) / step
        J = np.stack([dx, dy], axis=2)
        return np.asarray(np.linalg.svd(J, compute_uv=False)[:, -1])

    def sigma_along(self, mm: Floats, direction: Floats) -> Floats:
        """Return the standard deviation in mm, along ``direction`` (n, 2), of where the camera puts points (n, 2)."""
        scaled = (self.to_pixels(mm) - self.centre) / self.half
        J = np.empty((len(mm), 9))
        for k in range(9):
            step = np.zeros(9)
            step[k] = 1e-6 * max(1.0, abs(self.values[k]))
            moved = _project(self.values + step, scaled) - _project(self.values - step, scaled)
            J[:, k] = np.sum(moved * direction, axis=1) / (2 * step[k])
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", J, self.covariance, J)))


def fit_camera(
    size: tuple[int, int],
    mm: Floats,
    pixels: Floats,
    circle: tuple[float, Floats] | None = None,
    with_lens: bool = False,
) -> tuple[Camera, Floats]:
    """Fit to marks at ``mm`` (n, 2) seen at ``pixels`` (n, 2); ``circle``: its radius, and pixels (m, 2) on it.

    Returns the camera and the distances (n) in mm that the marks are left with.

    Raises:
        ValueError: the marks do not span the plane.

    """
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    half = 0.5 * float(np.hypot(*size))
    scaled = (pixels - centre) / half
    start = np.append(_direct(scaled, mm), 0.0)
    free = np.arange(9 if with_lens else 8)
    rim = None if circle is None else (circle[0], (circle[1] - centre) / half)

    def residual(x: Floats) -> Floats:
        values = start.copy()
        values[free] = x
        parts = [(_project(values, scaled) - mm).ravel()]
        if rim is not None:
            parts.append(np.linalg.norm(_project(values, rim[1]), axis=1) - rim[0])
        return np.concatenate(parts)

    found = least_squares(residual, start[free], x_scale="jac", method="lm" if rim or len(mm) > 4 else "trf")
    values = start.copy()
    values[free] = found.x
    spare = len(found.fun) - len(free)
    variance = max(float(found.fun @ found.fun) / spare if spare > 0 else FLOOR_MM**2, FLOOR_MM**2)
    J = np.asarray(found.jac)
    covariance = np.zeros((9, 9))
    covariance[np.ix_(free, free)] = variance * np.linalg.pinv(J.T @ J)
    camera = Camera(centre, half, values, covariance)
    return camera, np.linalg.norm(camera.to_mm(pixels) - mm, axis=1)


def _project(values: Floats, scaled: Floats) -> Floats:
    flat = scaled * (1.0 + values[8] * np.einsum("ij,ij->i", scaled, scaled))[:, None]
    return _apply(np.append(values[:8], 1.0).reshape(3, 3), flat)


def _apply(H: Floats, points: Floats) -> Floats:
    out = points @ H[:, :2].T + H[:, 2]
    return np.asarray(out[:, :2] / out[:, 2:])


def _direct(a: Floats, b: Floats) -> Floats:
    """Linear solution for the eight values of the homography from ``a`` to ``b``."""
    zero, one = np.zeros(len(a)), np.ones(len(a))
    x = np.stack([a[:, 0], a[:, 1], one, zero, zero, zero, -b[:, 0] * a[:, 0], -b[:, 0] * a[:, 1]], axis=1)
    y = np.stack([zero, zero, zero, a[:, 0], a[:, 1], one, -b[:, 1] * a[:, 0], -b[:, 1] * a[:, 1]], axis=1)
    A, rhs = np.concatenate([x, y]), np.concatenate([b[:, 0], b[:, 1]])
    values, _, rank, _ = np.linalg.lstsq(A, rhs, rcond=1e-10)
    if rank < 8:
        raise ValueError("the marks lie on one line")
    return np.asarray(values)
