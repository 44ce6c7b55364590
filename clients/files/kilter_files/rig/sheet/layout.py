"""Where everything on the sheet is, in mm: origin at the circle's centre, x to quarter point 1, y to quarter point 2.

The circle is dashed. In a gap only the pencil is there, so a line that follows the circle is read beside no print, and
a stroke across the line at a gap's middle tells where along the circle the pencil was.

What is printed of a sheet: plain shapes, and the page in true mm that they make.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from kilter_files.ground.errors import UsageError
from kilter_files.ground.later import need
from kilter_files.rig.printed import (
    PAPER_MM,
    WHITE,
    Colour,
    Disc,
    Printed,
    Shape,
    Stroke,
    Text,
    marker_shapes,
    save_page,
)

Page = Literal["a4", "a3", "letter"]

PAGES_MM: dict[str, tuple[float, float]] = {name: PAPER_MM[name] for name in get_args(Page)}
PRINTER_MARGIN_MM = 5.0
SMALLEST_RADIUS_MM = 15.0
MARKER_MM = 14.0
MARKER_CELLS = 7  # 5 x 5 bits and a black border
CORNER_IDS = (0, 1, 2, 3)  # upper right, upper left, lower left, lower right
FIRST_RADIUS_ID = 20  # a fifth marker says the radius: 20 + 2 x mm
RADIUS_STEP_MM = 0.5
TARGET_OUT_MM = 10.0  # the quarter targets lie this far outside the circle
TARGET_MM = 2.8  # their radius
RING_MM = (1.7, 0.7)  # radii of the white inside a ring and of the dot in a bull's eye
PERIOD_MM = 7.0  # least arc from gap to gap
STROKE_MM = 3.0  # a stroke reaches this far to both sides of the circle
LINE_MM = 0.2


@dataclass(frozen=True)
class Sheet:
    """A sheet for circles of ``radius_mm`` on a ``page``."""

    radius_mm: float
    page: Page = "a4"

    @property
    def dashes(self) -> int:
        """How many dashes, and so gaps, the circle has; the quarter points are in gaps."""
        return max(8, 4 * int(2 * math.pi * self.radius_mm / PERIOD_MM / 4))

    @property
    def gap_deg(self) -> float:
        """How far a gap reaches, the same as a dash."""
        return 180.0 / self.dashes

    @property
    def bar_mm(self) -> float:
        """Length of the two scale bars."""
        return max(10.0, 10.0 * math.floor(0.12 * self.radius_mm))

    @property
    def radius_id(self) -> int:
        """Number of the marker that says the radius."""
        return FIRST_RADIUS_ID + round(self.radius_mm / RADIUS_STEP_MM)

    def markers(self) -> dict[int, tuple[float, float]]:
        """Centres of the square markers, by number."""
        side = max(self.radius_mm, self.radius_mm / math.sqrt(2) + 16.0)
        corners = ((side, side), (-side, side), (-side, -side), (side, -side))
        return dict(zip(CORNER_IDS, corners, strict=True)) | {self.radius_id: (0.0, -(self.radius_mm + 26.0))}

    def targets(self) -> tuple[tuple[float, float], ...]:
        """Centres of the quarter targets: a ring at point 1, a bull's eye at point 2, then two discs."""
        out = self.radius_mm + TARGET_OUT_MM
        return ((out, 0.0), (0.0, out), (-out, 0.0), (0.0, -out))


def radius_from_marker(marker: int) -> float | None:
    """Return the radius a marker's number says, None when it says none."""
    radius = (marker - FIRST_RADIUS_ID) * RADIUS_STEP_MM
    return radius if radius >= SMALLEST_RADIUS_MM else None


def sheet_for(radius_mm: float, page: Page | None = None) -> Sheet:
    """Return the sheet of a radius on ``page``, or on A4 where it fits and else on A3.

    Raises:
        UsageError: a radius that fits no page or is not a multiple of half a mm.

    """
    steps = radius_mm / RADIUS_STEP_MM
    if not math.isfinite(steps) or abs(steps - round(steps)) > 1e-9 or radius_mm < SMALLEST_RADIUS_MM:
        raise UsageError(
            f"--radius-mm {radius_mm:g}: give a multiple of {RADIUS_STEP_MM:g} mm from {SMALLEST_RADIUS_MM:g} mm."
        )
    choices: tuple[Page, ...] = ("a4", "a3") if page is None else (page,)
    for choice in choices:
        if radius_mm <= largest_radius(choice):
            return Sheet(radius_mm, choice)
    limits = ", ".join(f"{name} {largest_radius(name):g}" for name in PAGES_MM)
    raise UsageError(f"--radius-mm {radius_mm:g} does not fit on the page. Largest radii in mm: {limits}.")


def largest_radius(page: str) -> float:
    """Return the largest radius in mm whose markers stay inside a printer's margins."""
    width, height = PAGES_MM[page]
    sideways = width / 2 - PRINTER_MARGIN_MM - max(TARGET_OUT_MM + TARGET_MM, MARKER_MM / 2)
    upright = height / 2 - PRINTER_MARGIN_MM - (26.0 + MARKER_MM / 2)
    return math.floor(min(sideways, upright) / RADIUS_STEP_MM) * RADIUS_STEP_MM


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
