"""From pixels to mm on the sheet: a homography, and one coefficient of a lens that bends straight lines.

A scan or a photo as pixels: PNG, JPEG, or one page of a PDF. Its size is looked at before anything is unpacked.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.later import Image, ImageOps, need, pypdfium2
from kilter_files.rig.see.pictures import whole_picture

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


Pixels = NDArray[np.uint8]

MOST_PIXELS = 150_000_000  # A4 at 1200 dpi, A3 at 850 dpi
LONGEST_SIDE = 30_000  # OpenCV's resampling counts pixels in 16 bits
MOST_BYTES = 1 << 29
MOST_PAGE_MM = 2000.0
PDF_DPI = 400.0
INCH_MM = 25.4
AGAIN = "Scan it again or copy the file again."


@dataclass(frozen=True)
class Picture:
    """``rgb`` (height, width, 3); ``px_per_mm`` as a scanner states it, None for photos."""

    path: Path
    rgb: Pixels
    px_per_mm: float | None


def read_picture(path: Path, page: int = 1) -> Picture:
    """Read a PNG, a JPEG, or the page of a PDF, rotated as the camera says it was held.

    Raises:
        FileError: another format, a damaged or cut file, more pixels than any scan needs, no such page.
        MissingPackageError: Pillow or pypdfium2 is not installed.

    """
    head = read_head(path, 1024)
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise fault(path, f"has {size >> 20} MB", "A scan of a sheet has less than 512 MB: use 300 to 600 dpi.")
    if b"%PDF-" in head:
        return _pdf(path, page)
    if head.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")):
        return _image(path)
    raise fault(path, "is not a PNG, JPEG or PDF", "Save the scan as PNG: it loses nothing.", byte=0)


def _image(path: Path) -> Picture:
    need("Reading a pencil sheet needs", "Pillow", "PIL.Image")
    try:
        with whole_picture(path, ("PNG", "JPEG")) as image:
            _check_size(path, *image.size)
            stated = image.info.get("dpi")
            turned = ImageOps.exif_transpose(image)
            rgb = _flat(turned)
    except FileError:
        raise
    except (Image.DecompressionBombError, MemoryError) as error:
        remedy = f"At most {MOST_PIXELS // 1_000_000} million are read: scan at 300 to 600 dpi."
        raise fault(path, "states more pixels than any scan has", remedy) from error
    except Exception as error:  # Pillow's decoders let OSError, SyntaxError, struct.error, ValueError and more through
        raise fault(path, f"is damaged or cut off: {str(error)[:120] or type(error).__name__}", AGAIN) from error
    return Picture(path, rgb, _density(stated))


def _flat(image: Any) -> Pixels:
    """Eight bits of red, green and blue; what is transparent is paper."""
    if image.mode in ("I;16", "I;16B", "I;16L", "I", "F"):
        deep = np.asarray(image, dtype=np.float64)
        grey = np.clip(deep / (257.0 if deep.max(initial=0) > 255 else 1.0), 0, 255).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    if image.mode in ("LA", "PA", "RGBA", "La", "RGBa") or "transparency" in image.info:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    return np.asarray(image.convert("RGB"), dtype=np.uint8)


def _density(stated: Any) -> float | None:
    """Pixels per mm of a scanner; 72 and 96 are what programs write when they do not know."""
    try:
        x, y = (float(value) for value in stated)
    except (TypeError, ValueError):
        return None
    return x / INCH_MM if 97 < x < 10_000 and abs(x - y) < 1e-3 * x else None


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MOST_PIXELS or max(width, height) > LONGEST_SIDE:
        what = f"states {width} x {height} pixels"
        raise fault(path, what, f"At most {MOST_PIXELS // 1_000_000} million are read: scan at 300 to 600 dpi.")


def _pdf(path: Path, page: int) -> Picture:
    need("Reading a pencil sheet needs", "pypdfium2")
    try:
        document = pypdfium2.PdfDocument(path)
    except pypdfium2.PdfiumError as error:
        remedy = "Open it in a viewer and print it to a new PDF; a password must be taken off."
        raise fault(path, f"is not a readable PDF: {str(error)[:120]}", remedy) from error
    try:
        count = len(document)
        if not 1 <= page <= count:
            remedy = f"Choose a page from 1 to {count} with --page." if count else "Scan the sheet into it again."
            raise fault(path, f"has {count or 'no'} pages", remedy, page=page)
        return _render_pdf_page(path, document, page)
    finally:
        document.close()


def _render_pdf_page(path: Path, document: Any, page: int) -> Picture:
    try:
        sheet = document[page - 1]
        width, height = (side * INCH_MM / 72 for side in sheet.get_size())
        if not (0 < width <= MOST_PAGE_MM and 0 < height <= MOST_PAGE_MM):
            what = f"states a page of {width:.4g} x {height:.4g} mm"
            raise fault(path, what, "Scan the sheet on A4 or A3.", page=page)
        dpi = min(PDF_DPI, INCH_MM * (MOST_PIXELS / (width * height)) ** 0.5)
        pixels = sheet.render(scale=dpi / 72, rev_byteorder=True).to_numpy()
    except (pypdfium2.PdfiumError, MemoryError, ValueError) as error:
        raise fault(path, f"cannot be drawn: {str(error)[:120]}", AGAIN, page=page) from error
    return Picture(path, np.array(pixels[:, :, :3]), dpi / INCH_MM)
