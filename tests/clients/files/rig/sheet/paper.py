"""Drawn sheets as a scanner or a camera sees them, made without OpenCV: the reader's library.

The print is drawn by pdfium from the PDF, the pencil by matplotlib, the camera, shadows and noise by Pillow, scipy and
numpy. What was drawn is given by functions, so the truth is known at every angle.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pypdfium2
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageFilter
from scipy.ndimage import gaussian_filter, map_coordinates

from kilter_files.rig.printed import page_pdf
from kilter_files.rig.sheet.layout import PAGES_MM, Sheet, sheet_page

Floats = NDArray[np.float64]
Along = Callable[[Floats], Floats]

INCH = 25.4
FINE_DPI = 300


def wobble(turn: Floats) -> Floats:
    """Errors in mm as a robot makes them: offsets, an oval, a ripple of gears."""
    t = np.asarray(turn)
    return 0.18 + 0.45 * np.cos(t - 1) + 0.3 * np.cos(2 * t + 0.3) + 0.06 * np.cos(9 * t)


def drift(turn: Floats) -> Floats:
    """Errors in mm along the circle."""
    t = np.asarray(turn)
    return -0.2 + 0.4 * np.sin(t + 0.4) + 0.2 * np.cos(3 * t)


@dataclass(frozen=True)
class Pencil:
    """How it draws: width in mm, colour, how dark, and how grainy."""

    width_mm: float = 0.5
    colour: tuple[float, float, float] = (0.25, 0.25, 0.27)
    dark: float = 0.85
    grain: float = 0.25


def drawn(
    sheet: Sheet,
    out: Along = wobble,
    along: Along | None = drift,
    pencil: Pencil = Pencil(),
    *,
    turns: tuple[float, float] = (0.0, 2 * np.pi),
    more: tuple[Along, ...] = (),
    seed: int = 0,
    dpi: int = FINE_DPI,
) -> tuple[Floats, float]:
    """Print and draw: light (h, w, 3) of the part around the circle in 0..1, and its pixels per mm.

    The circle's centre is the middle of the picture.
    """
    aside = max(sheet.radius_mm, sheet.radius_mm / np.sqrt(2) + 16.0) + 10.0
    width, height = np.minimum(
        PAGES_MM[sheet.page], (2 * max(aside, sheet.radius_mm + 16.0), 2 * sheet.radius_mm + 72.0)
    )
    paper = _printed(sheet, dpi, width, height)
    ink = _pencilled(sheet, paper.shape[:2], dpi, out, along, pencil, turns, more)
    rng = np.random.default_rng(seed)
    grain = gaussian_filter(rng.standard_normal(ink.shape), 0.08 * dpi / INCH)
    grain = np.clip(1 - pencil.grain * np.abs(grain) / grain.std(), 0, 1)
    cover = (pencil.dark * ink * grain)[:, :, None]
    return paper * (1 - cover * (1 - np.array(pencil.colour))), dpi / INCH


def _printed(sheet: Sheet, dpi: int, width: float, height: float) -> Floats:
    document = pypdfium2.PdfDocument(page_pdf(sheet_page(sheet)))
    page = document[0].render(scale=dpi / 72, rev_byteorder=True).to_numpy()[:, :, :3] / 255.0
    document.close()
    cut = [
        max(0, round((have - want * dpi / INCH) / 2)) for have, want in zip(page.shape, (height, width), strict=False)
    ]
    h, w = page.shape[:2]
    return np.ascontiguousarray(page[cut[0] : h - cut[0], cut[1] : w - cut[1]])


def _pencilled(
    sheet: Sheet, shape: tuple[int, int], dpi: int, out: Along, along: Along | None, pencil: Pencil,
    turns: tuple[float, float], more: tuple[Along, ...],
) -> Floats:  # fmt: skip
    height, width = shape
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(-width / dpi * INCH / 2, width / dpi * INCH / 2)
    axes.set_ylim(-height / dpi * INCH / 2, height / dpi * INCH / 2)
    points = pencil.width_mm / INCH * 72
    t = np.linspace(*turns, 3000)
    for line in (out, *more):
        r = sheet.radius_mm + line(t)
        axes.plot(r * np.cos(t), r * np.sin(t), color="black", linewidth=points, solid_capstyle="round")
    if along is not None:
        for k in range(sheet.dashes):
            turn = 2 * np.pi * k / sheet.dashes
            if turns[0] <= turn <= turns[1]:
                radial, tangent = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
                middle = (sheet.radius_mm + out(turn)) * radial + along(turn) * tangent
                ends = np.array([middle - 3 * radial, middle + 3 * radial])
                axes.plot(ends[:, 0], ends[:, 1], color="black", linewidth=points, solid_capstyle="round")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    grey = np.asarray(canvas.buffer_rgba())[:, :, 0] / 255.0
    assert grey.shape == shape
    return 1.0 - grey


@dataclass(frozen=True)
class View:
    """How the sheet is seen: ``tilt_deg`` about two axes, turned, bent by a lens; then light, blur, noise, JPEG."""

    dpi: float = 260.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    lens: float = 0.0
    blur_px: float = 0.6
    shadow: float = 0.0
    noise: float = 0.01
    jpeg: int | None = None
    grey: bool = False
    mirrored: bool = False
    skew: float = 0.0
    bulge_mm: float = 0.0
    seed: int = 0


def seen(paper: Floats, px_per_mm: float, view: View) -> Image.Image:
    """Return the picture a scanner (no tilt) or a camera (30 sheet widths of 1 m away) takes."""
    height, width = paper.shape[:2]
    scale = view.dpi / INCH
    size_mm = np.array([width, height]) / px_per_mm
    margin = 1.0 if view.tilt_deg == (0.0, 0.0) and view.turn_deg == 0 else 1.25
    out_w, out_h = (int(side * scale * margin) for side in size_mm)
    if abs(np.sin(np.radians(view.turn_deg))) > 0.7:
        out_w, out_h = out_h, out_w
    x, y = np.meshgrid(np.arange(out_w), np.arange(out_h))
    u = np.stack([x - (out_w - 1) / 2, y - (out_h - 1) / 2], axis=-1)
    half = 0.5 * np.hypot(out_w, out_h)
    # A real lens bends with the third and the fifth power; the reader knows the third alone.
    r2 = np.sum((u / half) ** 2, axis=-1, keepdims=True)
    u = u * (1 + view.lens * r2 + 0.15 * view.lens * r2**2)
    mm = _on_sheet(u / scale, view)
    px = np.stack([mm[..., 1] * -px_per_mm + (height - 1) / 2, mm[..., 0] * px_per_mm + (width - 1) / 2])
    step = max(1.0, px_per_mm / scale)
    smooth = gaussian_filter(paper, (0.42 * step, 0.42 * step, 0)) if step > 1 else paper
    light = np.stack([map_coordinates(smooth[:, :, c], px, order=1, mode="constant", cval=0.55) for c in range(3)], -1)
    return _taken(light, view)


def _on_sheet(flat: Floats, view: View) -> Floats:
    """Rays of a pinhole 450 mm above the sheet's middle, to mm on the sheet with y up."""
    far = 450.0
    a, b = np.radians(view.tilt_deg)
    c, s = np.cos(np.radians(view.turn_deg)), np.sin(np.radians(view.turn_deg))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    R = about_x @ about_y @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    x = flat[..., 0] * (-1 if view.mirrored else 1) + view.skew * flat[..., 1]
    rays = np.stack([x, -flat[..., 1], np.full(x.shape, -far)], axis=-1) @ R
    eye = R.T @ np.array([0.0, 0.0, far])
    t = -eye[2] / rays[..., 2]
    flat = (eye + t[..., None] * rays)[..., :2]
    # Paper that stands up along a ridge is met by the ray before it meets the plate.
    rise = view.bulge_mm * np.exp(-((flat[..., :1] / 50.0) ** 2))
    return np.asarray(flat - rise * (flat - eye[:2]) / eye[2])


def _taken(light: Floats, view: View) -> Image.Image:
    height, width = light.shape[:2]
    if view.shadow:
        x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        edge = 1 / (1 + np.exp(-(x + 0.4 * y - 0.2) / 0.03))  # the edge of a hand's shadow
        light = light * (1 - view.shadow * (0.6 * edge + 0.4 * (x**2 + y**2) / 2))[:, :, None]
    rng = np.random.default_rng(view.seed)
    picture = Image.fromarray((np.clip(light, 0, 1) * 255).astype(np.uint8))
    picture = picture.filter(ImageFilter.GaussianBlur(view.blur_px))
    noisy = np.asarray(picture, dtype=np.float32) + rng.standard_normal((height, width, 3), dtype=np.float32) * (
        255 * view.noise
    )
    picture = Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8))
    if view.grey:
        picture = picture.convert("L")
    if view.jpeg is not None:
        out = io.BytesIO()
        picture.save(out, "JPEG", quality=view.jpeg)
        picture = Image.open(io.BytesIO(out.getvalue()))
        picture.load()
    return picture


def save(picture: Image.Image, path: Path, dpi: float | None = None) -> Path:
    """Write a picture as the ending says, with the scanner's resolution where there is one."""
    if dpi is None:
        picture.save(path)
    else:
        picture.save(path, dpi=(dpi, dpi))
    return path
