"""What is printed of a sheet: plain shapes, and the page in true mm that they make."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from kilter_files.ground.later import need
from kilter_files.rig.printed import WHITE, Colour, Disc, Printed, Shape, Stroke, Text, marker_shapes, save_page
from kilter_files.rig.sheet.layout import (
    LINE_MM,
    MARKER_CELLS,
    MARKER_MM,
    PAGES_MM,
    RING_MM,
    STROKE_MM,
    TARGET_MM,
    Sheet,
)

PALE: Colour = (0.35, 0.75, 0.88)  # cyan: the red of a colour scan sees it, its blue hardly does
GREY: Colour = (0.35, 0.35, 0.35)


def aruco() -> tuple[Any, Any]:
    """Return OpenCV and the dictionary of the markers.

    Raises:
        MissingPackageError: OpenCV is not installed.

    """
    cv2 = need("The pencil sheet needs", "OpenCV", "cv2", install="opencv-python-headless")
    return cv2, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)


def shapes(sheet: Sheet) -> list[Shape]:
    """Return everything that is printed on a sheet, in the order of drawing."""
    return [*_circle(sheet), *_markers(sheet), *_targets(sheet), *_ticks(sheet), *_bars(sheet), *_words(sheet)]


def _circle(sheet: Sheet) -> Iterator[Shape]:
    half = sheet.gap_deg / 2
    for k in range(sheet.dashes):
        middle = (2 * k + 1) * sheet.gap_deg  # gaps are at the even multiples
        angles = [math.radians(middle - half + sheet.gap_deg * i / 16) for i in range(17)]
        points = tuple((sheet.radius_mm * math.cos(a), sheet.radius_mm * math.sin(a)) for a in angles)
        yield Stroke(points, LINE_MM, PALE)


def _markers(sheet: Sheet) -> Iterator[Shape]:
    known = aruco()
    for number, (x, y) in sheet.markers().items():
        yield from marker_shapes(known, number, x - MARKER_MM / 2, y + MARKER_MM / 2, MARKER_MM, MARKER_CELLS)


def _targets(sheet: Sheet) -> Iterator[Shape]:
    for number, (x, y) in enumerate(sheet.targets()):
        yield Disc(x, y, TARGET_MM)
        if number < 2:
            yield Disc(x, y, RING_MM[0], WHITE)
        if number == 1:
            yield Disc(x, y, RING_MM[1])


def _ticks(sheet: Sheet) -> Iterator[Shape]:
    """Lines that point at the four quarter points and leave them free for the pencil."""
    for k in range(4):
        c, s = math.cos(k * math.pi / 2), math.sin(k * math.pi / 2)
        for side in (-1, 1):
            near, far = (sheet.radius_mm + side * (STROKE_MM + beyond) for beyond in (1.5, 3.0))
            yield Stroke(((near * c, near * s), (far * c, far * s)))


def _bars(sheet: Sheet) -> Iterator[Shape]:
    half = sheet.bar_mm / 2
    for along, across in (((1, 0), (0, 1)), ((0, 1), (1, 0))):
        yield Stroke(((-half * along[0], -half * along[1]), (half * along[0], half * along[1])))
        for k in range(round(sheet.bar_mm) + 1):
            size = 1.5 if k % 10 == 0 else 1.0 if k % 5 == 0 else 0.6
            at = k - half
            x, y = at * along[0], at * along[1]
            yield Stroke(((x, y), (x + size * across[0], y + size * across[1])), 0.12)


def _words(sheet: Sheet) -> Iterator[Shape]:
    r, size = sheet.radius_mm, min(2.6, 0.033 * sheet.radius_mm)
    yield Text(0, 0.74 * r, f"Kilter sheet, radius {r:g} mm", 1.3 * size)
    yield Text(0, 0.74 * r - 2 * size, "Print at 100 %, not fitted to the page.", size)
    yield Text(0, -0.68 * r, f"Both bars are {sheet.bar_mm:g} mm long: measure them.", size)
    yield Text(0, -0.68 * r - 1.6 * size, "Draw on the circle; strokes across it, 3 mm to", size)
    yield Text(0, -0.68 * r - 3.2 * size, f"both sides, in the {sheet.dashes} gaps.", size)
    for number, (x, y) in enumerate(sheet.targets(), 1):
        turned = math.hypot(x, y) / 5.0
        yield Text(x - y / turned, y + x / turned - 0.9, str(number))


def save_sheet(sheet: Sheet, path: Path) -> int:
    """Write the sheet as the file's ending says, ``.pdf`` or ``.svg``; returns the bytes written.

    Raises:
        UsageError: another ending.
        FileError: the file cannot be written.
        MissingPackageError: OpenCV, or for PDF reportlab, is not installed.

    """
    return save_page(sheet_page(sheet), path)


def sheet_page(sheet: Sheet) -> Printed:
    """Return the page of the sheet; the same sheet gives the same bytes."""
    return Printed(f"Kilter sheet, radius {sheet.radius_mm:g} mm", PAGES_MM[sheet.page], tuple(shapes(sheet)))
