"""The ring around the circle, unrolled: darkness over radius and angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter

from kilter_files.ground.arrays import Floats
from kilter_files.rig.sheet.camera import Camera
from kilter_files.rig.sheet.layout import Sheet
from kilter_files.rig.sheet.picture import Pixels
from kilter_files.rig.sheet.shapes import aruco

REACH_MM = 4.4  # inside and outside the circle; the printed ticks begin behind it
STEP_MM = 0.04
ALONG_MM = 0.08
PAPER_MM = 2.4


@dataclass(frozen=True)
class Ring:
    """``dark`` (channels, radii, angles): 0 paper, 1 black; ``out_mm`` (radii) from the circle; ``turn`` (angles) rad.

    Angles come period by period: ``per_period`` of them around each gap's middle, from dash middle to dash middle.
    """

    sheet: Sheet
    dark: Floats
    out_mm: Floats
    turn: Floats
    per_period: int

    @property
    def periods(self) -> int:
        """How many gaps there are."""
        return self.sheet.dashes

    def gaps(self) -> Floats:
        """Return the darkness (channels, gaps, radii, angles of a period)."""
        channels, radii, _ = self.dark.shape
        return self.dark.reshape(channels, radii, self.periods, self.per_period).transpose(0, 2, 1, 3)

    def along_mm(self) -> Floats:
        """Return where the angles of a period are, in mm along the circle from the gap's middle."""
        k = np.arange(self.per_period) - (self.per_period - 1) / 2
        return np.asarray(k * (2 * np.pi * self.sheet.radius_mm / self.dark.shape[2]))


def unroll(rgb: Pixels, camera: Camera, sheet: Sheet) -> Ring:
    """Resample the ring and divide it by its paper, so that shadows and lamps are gone."""
    cv2, _ = aruco()
    period = 2 * np.pi * sheet.radius_mm / sheet.dashes
    per_period = max(16, round(period / ALONG_MM))
    count = per_period * sheet.dashes
    out: Floats = np.arange(-REACH_MM, REACH_MM + STEP_MM / 2, STEP_MM, dtype=np.float64)
    turn = np.asarray((np.arange(count) - (per_period - 1) / 2) * (2 * np.pi / count), dtype=np.float64)
    r = sheet.radius_mm + out[:, None]
    points = np.stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()], axis=1)
    at = camera.to_pixels(points).astype(np.float32)
    shape = (len(out), count)
    map_x, map_y = at[:, 0].reshape(shape), at[:, 1].reshape(shape)
    # OpenCV counts pixels of the result in 16 bits.
    parts = [
        cv2.remap(
            rgb,
            map_x[:, k : k + 16_000],
            map_y[:, k : k + 16_000],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(255, 255, 255),
        )
        for k in range(0, count, 16_000)
    ]
    light = np.concatenate(parts, axis=1).astype(np.float64).transpose(2, 0, 1)
    return Ring(sheet, 1.0 - light / _paper(light), out, turn, per_period)


def _paper(light: Floats) -> Floats:
    """Return how bright the paper would be: a level and slope over the radius at each angle, smooth along the angle."""
    half = light.shape[1] // 2
    x = np.linspace(-1, 1, light.shape[1])[None, :, None]
    # The brighter part of either side is paper, whatever is drawn along it; the median passes over strokes across it.
    inner, outer = (np.quantile(part, 0.7, axis=1) for part in (light[:, :half], light[:, half:]))
    window = (1, 2 * round(PAPER_MM / ALONG_MM / 2) + 1)
    inner, outer = (
        gaussian_filter1d(median_filter(part, window, mode="wrap"), 6, mode="wrap") for part in (inner, outer)
    )
    return np.maximum((inner + outer)[:, None, :] / 2 + (outer - inner)[:, None, :] * x, 8.0)
