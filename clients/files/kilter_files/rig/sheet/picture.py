"""A scan or a photo as pixels: PNG, JPEG, or one page of a PDF. Its size is looked at before anything is unpacked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.later import Image, ImageOps, need, pypdfium2
from kilter_files.rig.whole_picture import whole_picture

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
