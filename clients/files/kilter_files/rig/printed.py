"""Pages in true mm from plain shapes: as SVG, written here, and as PDF, written by reportlab."""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import need

POINTS_PER_MM = 72 / 25.4
PAPER_MM: dict[str, tuple[float, float]] = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
}

Colour = tuple[float, float, float]

BLACK: Colour = (0.0, 0.0, 0.0)
WHITE: Colour = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Rect:
    """A filled rectangle from its lower left corner."""

    x: float
    y: float
    width: float
    height: float
    colour: Colour = BLACK


@dataclass(frozen=True)
class Disc:
    """A filled disc."""

    x: float
    y: float
    radius: float
    colour: Colour = BLACK


@dataclass(frozen=True)
class Stroke:
    """A line through points."""

    points: tuple[tuple[float, float], ...]
    width: float = 0.2
    colour: Colour = BLACK


@dataclass(frozen=True)
class Text:
    """Words centred on a point; ``size`` in mm."""

    x: float
    y: float
    text: str
    size: float = 2.6


Shape = Rect | Disc | Stroke | Text


@dataclass(frozen=True)
class Printed:
    """A page of ``size_mm`` (width, height) with its shapes: origin at the page's middle, x right, y up."""

    title: str
    size_mm: tuple[float, float]
    shapes: tuple[Shape, ...]


def check_ending(path: Path, what: str = "it") -> None:
    """Refuse an ending with which no page is written.

    Raises:
        UsageError: neither ``.pdf`` nor ``.svg``.

    """
    if path.suffix.lower() not in (".pdf", ".svg"):
        raise UsageError(f"{path}: {what} is written as .pdf or .svg.")


def save_page(page: Printed, path: Path) -> int:
    """Write the page as the file's ending says, ``.pdf`` or ``.svg``; returns the bytes written.

    Raises:
        UsageError: another ending.
        FileError: the file cannot be written.
        MissingPackageError: reportlab is not installed, for PDF.

    """
    check_ending(path)
    return _write(path, page_svg(page).encode() if path.suffix.lower() == ".svg" else page_pdf(page))


def save_described(document: dict[str, Any], page: Printed, path: Path) -> dict[str, Any]:
    """Write the page, and the document that describes it as JSON beside it; returns that document.

    Raises:
        UsageError: another ending.
        FileError: a file cannot be written.
        MissingPackageError: reportlab is not installed, for PDF.

    """
    save_page(page, path)
    _write(path.with_suffix(".json"), (json.dumps(document, indent=1) + "\n").encode())
    return document


def _write(path: Path, content: bytes) -> int:
    try:
        return path.write_bytes(content)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}.", file=str(path)) from error


def page_svg(page: Printed) -> str:
    """Return the page as SVG text; its user units are mm, y up through the group's transform."""
    width, height = page.size_mm
    body = "\n".join(_svg(shape) for shape in page.shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n<rect width="{width:g}" height="{height:g}" fill="#fff"/>\n'
        f'<g transform="translate({width / 2:g} {height / 2:g})">\n{body}\n</g>\n</svg>\n'
    )


def _svg(shape: Shape) -> str:
    if isinstance(shape, Rect):
        top = -(shape.y + shape.height)
        size = f'width="{shape.width:.4f}" height="{shape.height:.4f}"'
        return f'<rect x="{shape.x:.4f}" y="{top:.4f}" {size} fill="{_hex(shape.colour)}"/>'
    if isinstance(shape, Disc):
        return f'<circle cx="{shape.x:.4f}" cy="{-shape.y:.4f}" r="{shape.radius:g}" fill="{_hex(shape.colour)}"/>'
    if isinstance(shape, Stroke):
        points = " ".join(f"{x:.4f},{-y:.4f}" for x, y in shape.points)
        ink = f'stroke="{_hex(shape.colour)}" stroke-width="{shape.width:g}"'
        return f'<polyline points="{points}" fill="none" {ink}/>'
    font = f'font-family="Helvetica, Arial, sans-serif" font-size="{shape.size:.3f}" text-anchor="middle"'
    return f'<text x="{shape.x:.3f}" y="{-shape.y:.3f}" {font}>{escape(shape.text)}</text>'


def _hex(colour: Colour) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour)


def page_pdf(page: Printed) -> bytes:
    """Return the page as a PDF; the same page gives the same bytes.

    Raises:
        MissingPackageError: reportlab is not installed.

    """
    reportlab = need("PDF needs", "reportlab", "reportlab.pdfgen.canvas", instead="write SVG (-o with the ending .svg)")
    width, height = (side * POINTS_PER_MM for side in page.size_mm)
    out = io.BytesIO()
    canvas = reportlab.Canvas(out, pagesize=(width, height), invariant=1, pageCompression=1)
    canvas.setTitle(page.title)
    # Viewers offer "no scaling" first when a document asks for it.
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.translate(width / 2, height / 2)
    canvas.scale(POINTS_PER_MM, POINTS_PER_MM)
    for shape in page.shapes:
        _pdf(canvas, shape)
    canvas.showPage()
    canvas.save()
    return out.getvalue()


def _pdf(canvas: Any, shape: Shape) -> None:
    if isinstance(shape, Rect):
        canvas.setFillColorRGB(*shape.colour)
        canvas.rect(shape.x, shape.y, shape.width, shape.height, stroke=0, fill=1)
    elif isinstance(shape, Disc):
        canvas.setFillColorRGB(*shape.colour)
        canvas.circle(shape.x, shape.y, shape.radius, stroke=0, fill=1)
    elif isinstance(shape, Stroke):
        canvas.setStrokeColorRGB(*shape.colour)
        canvas.setLineWidth(shape.width)
        path = canvas.beginPath()
        path.moveTo(*shape.points[0])
        for point in shape.points[1:]:
            path.lineTo(*point)
        canvas.drawPath(path, stroke=1, fill=0)
    elif isinstance(shape, Text):
        canvas.setFillColorRGB(0, 0, 0)
        canvas.setFont("Helvetica", shape.size)
        canvas.drawCentredString(shape.x, shape.y, shape.text)


def marker_shapes(
    aruco: tuple[Any, Any], number: int, left: float, top: float, side: float, cells: int
) -> Iterator[Rect]:
    """Draw a marker of a dictionary, given with its OpenCV, from its upper left corner; ``cells`` count its border."""
    cv2, dictionary = aruco
    cell = side / cells
    black = cv2.aruco.generateImageMarker(dictionary, number, cells) == 0
    yield Rect(left, top - side, side, side)
    for k in range(cells):
        for start, length in _white(black[k]):
            yield Rect(left + start * cell, top - (k + 1) * cell, length * cell, cell, WHITE)


def _white(cells: Any) -> Iterator[tuple[int, int]]:
    at = 0
    for black, group in itertools.groupby(bool(cell) for cell in cells):
        length = len(list(group))
        if not black:
            yield at, length
        at += length
