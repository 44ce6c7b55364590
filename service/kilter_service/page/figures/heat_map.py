"""A heat map: a matrix of numbers as colours, with their scale beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from kilter_service.page.figures.plot import FONT, LETTER
from kilter_service.page.figures.scale import written

# Dark to light in even steps, so that it prints in black and white; the other goes from blue over white to red.
SEQUENTIAL = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
DIVERGING = ((33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43))
STEPS = 5  # numbers beside the scale


@dataclass(frozen=True)
class HeatMap:
    """``values`` by row and column; ``diverging``: zero is in the middle of the scale. NaN is left blank."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    values: Sequence[Sequence[float]]
    unit: str = ""
    low: float = 0.0
    high: float = 1.0
    diverging: bool = False
    description: str = ""
    cell: float = 26.0
    write: bool = True  # the number in each cell, where it has room

    @property
    def table(self) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
        """The same numbers."""
        body = [
            [name, *(f"{v:.3g}" if math.isfinite(v) else "–" for v in row)]
            for name, row in zip(self.rows, self.values, strict=True)
        ]
        return ["", *self.columns], body

    def svg(self) -> Markup:
        """Return it as SVG."""
        left = 12 + LETTER * max((len(name) for name in self.rows), default=0)
        below = 16 + 0.8 * LETTER * max((len(name) for name in self.columns), default=0)
        width, height = self.cell * len(self.columns), self.cell * len(self.rows)
        total = left + width + 90
        tall = max(height, 120.0)
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {tall + below + 8:.0f}" role="img" '
            f'width="{total:.0f}" height="{tall + below + 8:.0f}" {FONT} fill="currentColor">'
            f"<title>{escape(self.title)}</title><desc>{escape(self.description or self.title)}</desc>"
        )
        body = self._cells(left) + self._names(left, height) + self._scale(left + width + 24, tall)
        return Markup(f"{head}{body}</svg>")  # noqa: S704 (texts are escaped above)

    def colour(self, value: float) -> tuple[int, int, int]:
        """Return the colour of a value."""
        share = (value - self.low) / (self.high - self.low) if self.high > self.low else 0.0
        stops = DIVERGING if self.diverging else SEQUENTIAL
        place = min(max(share, 0.0), 1.0) * (len(stops) - 1)
        first = min(int(place), len(stops) - 2)
        return tuple(  # type: ignore[return-value]  # of three
            round(a + (place - first) * (b - a)) for a, b in zip(stops[first], stops[first + 1], strict=True)
        )

    def _cells(self, left: float) -> str:
        parts = []
        for i, row in enumerate(self.values):
            for j, value in enumerate(row):
                if not math.isfinite(value):
                    continue
                red, green, blue = self.colour(value)
                x, y = left + j * self.cell, 4 + i * self.cell
                name = escape(f"{self.rows[i]}, {self.columns[j]}: {value:.3g} {self.unit}".strip())
                parts.append(
                    f'<rect x="{x:.1f}" y="{y:.1f}" width="{self.cell:.1f}" height="{self.cell:.1f}" '
                    f'fill="#{red:02x}{green:02x}{blue:02x}"><title>{name}</title></rect>'
                )
                text = self._short(value)
                if self.write and len(text) * LETTER * 0.85 < self.cell:
                    ink = "#000" if 0.3 * red + 0.59 * green + 0.11 * blue > 140 else "#fff"
                    parts.append(
                        f'<text x="{x + self.cell / 2:.1f}" y="{y + self.cell / 2 + 3.5:.1f}" font-size="10" '
                        f'text-anchor="middle" fill="{ink}" pointer-events="none">{escape(text)}</text>'
                    )
        return "".join(parts)

    def _short(self, value: float) -> str:
        """What is written in a cell: two digits, none of them of rounding."""
        if abs(value) < 0.005 * max(abs(self.low), abs(self.high)):
            return "0"
        return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"

    def _names(self, left: float, height: float) -> str:
        parts = [
            f'<text x="{left - 6:.1f}" y="{4 + (i + 0.5) * self.cell + 4:.1f}" text-anchor="end">{escape(name)}</text>'
            for i, name in enumerate(self.rows)
        ]
        parts += [
            f'<text transform="translate({left + (j + 0.5) * self.cell + 4:.1f} {height + 12:.1f}) rotate(-55)" '
            f'text-anchor="end">{escape(name)}</text>'
            for j, name in enumerate(self.columns)
        ]
        return "".join(parts)

    def _scale(self, x: float, height: float) -> str:
        slices = 24
        parts = []
        for k in range(slices):
            value = self.low + (self.high - self.low) * (k + 0.5) / slices
            red, green, blue = self.colour(value)
            y = 4 + height * (1 - (k + 1) / slices)
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="12" height="{height / slices + 0.5:.1f}" '
                f'fill="#{red:02x}{green:02x}{blue:02x}"/>'
            )
        step = (self.high - self.low) / (STEPS - 1) or 1.0
        for k in range(STEPS):
            y = 4 + height * (1 - k / (STEPS - 1))
            parts.append(f'<text x="{x + 16:.1f}" y="{max(y + 4, 12):.1f}">{written(self.low + k * step, step)}</text>')
        return "".join(parts)
