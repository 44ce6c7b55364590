"""Pictures of printed pages by a ray caster of its own: the rectangles of an SVG through a lens, with blur and noise.

It knows nothing of what finds boards. Each pixel is the mean of the rays through it, after the blur; the centre of the
upper left pixel is (0, 0).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter, uniform_filter1d
from scipy.spatial.transform import Rotation

SVG = "{http://www.w3.org/2000/svg}"
WHITE, BLACK, ROOM = 205.0, 35.0, 110.0


@dataclass
class Page:
    """Grey levels of a page in mm from the origin of its board, which is at ``origin`` of the page."""

    x: Any
    y: Any
    grey: Any

    @classmethod
    def read(cls, svg: Path, document: dict[str, Any], mirrored: bool = False) -> Page:
        root = ET.fromstring(svg.read_text())
        page = document["page"]
        shift = np.array([page["width_mm"] / 2 - page["left_mm"], page["height_mm"] / 2 - page["top_mm"]])
        boxes = []
        for box in root.find(f"{SVG}g").findall(f"{SVG}rect"):
            low = np.array([float(box.get("x")), float(box.get("y"))]) + shift
            size = np.array([float(box.get("width")), float(box.get("height"))])
            boxes.append((low, low + size, BLACK if box.get("fill") == "#000000" else WHITE))
        whole = np.array([-page["left_mm"], -page["top_mm"]])
        ends = [whole, np.add(whole, [page["width_mm"], page["height_mm"]])]
        if mirrored:
            width = document["columns"] * document["square_mm"]
            boxes = [
                (np.array([width - high[0], low[1]]), np.array([width - low[0], high[1]]), grey)
                for low, high, grey in boxes
            ]
        x, y = (np.unique(np.round([p[k] for b in [(*ends, 0), *boxes] for p in b[:2]], 6)) for k in range(2))
        grey = np.full((len(y) - 1, len(x) - 1), WHITE)
        for low, high, level in boxes:
            (i, j), (m, n) = (np.searchsorted(a, np.round([low[k], high[k]], 6)) for k, a in ((0, x), (1, y)))
            grey[m:n, i:j] = level
        return cls(x, y, grey)

    def at(self, x: Any, y: Any) -> Any:
        i, m = np.searchsorted(self.x, x, "right") - 1, np.searchsorted(self.y, y, "right") - 1
        inside = (i >= 0) & (i < len(self.x) - 1) & (m >= 0) & (m < len(self.y) - 1)
        found = self.grey[np.clip(m, 0, len(self.y) - 2), np.clip(i, 0, len(self.x) - 2)]
        return np.where(inside, found, ROOM)


@dataclass
class Lens:
    """A camera: pinhole, Brown (k1 k2 p1 p2 k3), rational (k1 k2 p1 p2 k3 k4 k5 k6) or fisheye (four)."""

    width: int = 800
    height: int = 600
    focal: tuple[float, float] = (900.0, 905.0)
    centre: tuple[float, float] = (403.3, 296.1)
    model: str = "none"
    k: tuple[float, ...] = ()

    def distorted(self, x: Any, y: Any) -> tuple[Any, Any]:
        if self.model == "fisheye":
            r = np.hypot(x, y)
            t = np.arctan(r)
            k1, k2, k3, k4 = self.k
            scale = np.where(
                r > 1e-12, t * (1 + k1 * t**2 + k2 * t**4 + k3 * t**6 + k4 * t**8) / np.maximum(r, 1e-12), 1
            )
            return x * scale, y * scale
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.k, *[0.0] * (8 - len(self.k)))
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def pixels(self, points: Any) -> Any:
        x, y = self.distorted(points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
        return np.stack([self.focal[0] * x + self.centre[0], self.focal[1] * y + self.centre[1]], axis=-1)

    def rays(self, u: Any, v: Any) -> tuple[Any, Any]:
        """Directions x / z and y / z of sorted pixels u and v (grids), by iteration on a coarse grid and a spline."""
        cu, cv = (np.linspace(a.min() - 4, a.max() + 4, int(np.ptp(a) / 5) + 8) for a in (u, v))
        gu, gv = np.meshgrid(cu, cv)
        xd, yd = (gu - self.centre[0]) / self.focal[0], (gv - self.centre[1]) / self.focal[1]
        x, y = xd.copy(), yd.copy()
        for _ in range(60 if self.k else 0):
            ex, ey = self.distorted(x, y)
            x, y = x - (ex - xd), y - (ey - yd)
        return tuple(RectBivariateSpline(cv, cu, part)(v, u) for part in (x, y))


@dataclass
class Shot:
    """How a picture is taken: the board's pose in the camera's frame, and what the camera does."""

    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 350.0)
    blur_px: float = 0.7
    motion_px: tuple[float, float] = (0.0, 0.0)
    noise: float = 2.0
    gain: float = 1.0
    seed: int = 0
    samples: int = 4
    lens: Lens = field(default_factory=Lens)

    def pose(self, document: dict[str, Any]) -> tuple[Any, Any]:
        middle = np.array([document["columns"], document["rows"]]) * document["square_mm"] / 2
        turn = Rotation.from_euler("xyz", self.rotation_deg, degrees=True).as_matrix()
        return turn, np.array(self.centre_mm) - turn @ [*middle, 0.0]


def true_corners(document: dict[str, Any], shot: Shot) -> Any:
    """Pixels (n, 2) of the corners in the order of the JSON."""
    turn, origin = shot.pose(document)
    mm = np.array([[corner["x_mm"], corner["y_mm"], 0.0] for corner in document["corners"]])
    return shot.lens.pixels(mm @ turn.T + origin)


def picture(page: Page, document: dict[str, Any], shot: Shot) -> Any:
    """The picture of a page, 8 bits of grey."""
    return finished(clean(page, document, shot), shot)


def clean(page: Page, document: dict[str, Any], shot: Shot) -> Any:
    """The picture before noise and rounding."""
    turn, origin = shot.pose(document)
    n = shot.samples
    u, v = ((np.arange(side * n) + 0.5) / n - 0.5 for side in (shot.lens.width, shot.lens.height))
    bands = np.array_split(np.arange(len(v)), max(1, len(v) // 100))
    grey = np.concatenate([_band(page, shot.lens.rays(u, v[band]), turn, origin) for band in bands])
    if shot.blur_px:
        grey = gaussian_filter(grey, shot.blur_px * n, truncate=3.0)
    for axis, length in ((1, shot.motion_px[0]), (0, shot.motion_px[1])):
        if length:
            grey = uniform_filter1d(grey, 2 * int(length * n / 2) + 1, axis=axis)
    return grey.reshape(shot.lens.height, n, shot.lens.width, n).mean(axis=(1, 3)) * shot.gain


def _band(page: Page, rays: tuple[Any, Any], turn: Any, origin: Any) -> Any:
    """Grey levels where rays meet the page."""
    x, y = rays
    depth = (turn[:, 2] @ origin) / (x * turn[0, 2] + y * turn[1, 2] + turn[2, 2])
    across, down = (depth * (x * turn[0, k] + y * turn[1, k] + turn[2, k]) - origin @ turn[:, k] for k in range(2))
    return page.at(across, down)


def finished(grey: Any, shot: Shot) -> Any:
    """Noise and rounding."""
    rng = np.random.default_rng(shot.seed)
    return np.clip(np.round(grey + rng.normal(0, shot.noise, grey.shape)), 0, 255).astype(np.uint8)
