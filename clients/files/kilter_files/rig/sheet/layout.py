"""Where everything on the sheet is, in mm: origin at the circle's centre, x to quarter point 1, y to quarter point 2.

The circle is dashed. In a gap only the pencil is there, so a line that follows the circle is read beside no print, and
a stroke across the line at a gap's middle tells where along the circle the pencil was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from kilter_files.ground.errors import UsageError
from kilter_files.rig.printed import PAPER_MM

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
