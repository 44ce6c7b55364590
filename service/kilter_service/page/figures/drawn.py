"""Figures beside plots: heat maps, points in space with arrows, and small drawings for a row of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from kilter_service.page.figures.plot import LETTER, Axis, room_for, whole_svg, written
from kilter_service.page.words import mm

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
        parts = self._cells(left), self._names(left, height), self._scale(left + width + 24, tall)
        said = self.description or self.title
        return whole_svg(round(total), round(tall + below + 8), parts, self.title, said)

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


Point = Sequence[float]
ACROSS, DEEP = math.cos(math.radians(25)), math.sin(math.radians(25))
AROUND, CELLS, LONGEST = 34.0, 6, 0.22  # pixels beside it, cells of the ground, length of the longest arrow by its size


@dataclass(frozen=True)
class Arrows:
    """Arrows of one look, mm: one at each point; None: none there."""

    label: str
    look: str
    vectors: Sequence[Point | None]


@dataclass(frozen=True)
class Space:
    """Points ``at`` mm, named, with arrows that are drawn so much longer than they are that the largest is seen."""

    title: str
    at: Sequence[Point]
    names: Sequence[str]
    arrows: Sequence[Arrows]
    width: float = 620.0
    height: float = 245.0
    table: tuple[Sequence[str], Sequence[Sequence[str]]] = ((), ())

    @property
    def times(self) -> int:
        """By how much longer the arrows are drawn: 1, 2 or 5 times a power of ten."""
        sizes = [math.hypot(*one) for kind in self.arrows for one in kind.vectors if one is not None]
        wanted = LONGEST * self._span() / max(max(sizes, default=1.0), 1e-9)
        power = 10 ** math.floor(math.log10(max(wanted, 1.0)))
        return int(max(part * power for part in (1, 2, 5) if part * power <= max(wanted, 1.0)))

    def _span(self) -> float:
        every = [*self.at, (0.0, 0.0, 0.0)]
        return max(max(one[k] for one in every) - min(one[k] for one in every) for k in range(3)) or 1.0

    def svg(self) -> Markup:
        """Draw it."""
        times, ground = self.times, min(0.0, *(one[2] for one in self.at))
        reach = max(max(abs(one[0]), abs(one[1])) for one in self.at) or 1.0
        tips = {
            kind.look: [self._tip(at, one, times) for at, one in zip(self.at, kind.vectors, strict=True)]
            for kind in self.arrows
        }
        corners = [(sx * reach, sy * reach, ground) for sx in (-1, 1) for sy in (-1, 1)]
        flat = [_flat(one) for one in (*self.at, *corners, *(tip for own in tips.values() for tip in own if tip))]
        width = room_for(self.width)
        scale = min(
            (width - 2 * AROUND) / (max(x for x, _ in flat) - min(x for x, _ in flat)),
            (self.height - 2 * AROUND) / (max(y for _, y in flat) - min(y for _, y in flat)),
        )
        left, top = min(x for x, _ in flat), max(y for _, y in flat)
        aside = (width - scale * (max(x for x, _ in flat) - left)) / 2

        def place(one: Point) -> str:
            x, y = _flat(one)
            return f"{aside + scale * (x - left):.1f} {AROUND + scale * (top - y):.1f}"

        parts = []
        for k in range(CELLS + 1):
            line = reach * (2 * k / CELLS - 1)
            parts.append(f'<path class="decade" d="M{place((line, -reach, ground))}L{place((line, reach, ground))}"/>')
            parts.append(f'<path class="decade" d="M{place((-reach, line, ground))}L{place((reach, line, ground))}"/>')
        long = 0.45 * reach
        for axis, end in zip("xyz", ((long, 0.0, ground), (0.0, long, ground), (0.0, 0.0, ground + long)), strict=True):
            x, y = place(end).split()
            parts.append(
                f'<path class="axis" d="M{place((0.0, 0.0, ground))}L{x} {y}"/><text x="{x}" y="{y}">{axis}</text>'
            )
        for at, name in zip(self.at, self.names, strict=True):
            x, y = place(at).split()
            parts.append(f'<path class="stem" d="M{x} {y}L{place((at[0], at[1], ground))}"/>')
            parts.append(f'<circle cx="{x}" cy="{y}" r="3.5"><title>{escape(name)}</title></circle>')
        for kind in self.arrows:
            for at, tip, one in zip(self.at, tips[kind.look], kind.vectors, strict=True):
                if tip is not None and one is not None:
                    told = f"<title>{escape(kind.label)}: {mm(math.hypot(*one))}</title>"
                    parts.append(_arrow(kind.look, place(at), place(tip), told))
        keys = "".join(
            f'<g transform="translate({AROUND + 150 * k:g} 14)">{_arrow(kind.look, "0 0", "24 0", "")}'
            f'<text x="32" y="4">{escape(kind.label)}</text></g>'
            for k, kind in enumerate(self.arrows)
        )
        said = f"{len(self.at)} points; arrows are drawn {times} times as long."
        return whole_svg(width, self.height, [keys, *parts], self.title, said, more='class="space" font-size="12"')

    @staticmethod
    def _tip(at: Point, vector: Point | None, times: int) -> Point | None:
        return None if vector is None else [a + times * v for a, v in zip(at, vector, strict=True)]


def _flat(point: Point) -> tuple[float, float]:
    """Where a point is on the picture, seen from the corner between x and -y, mm."""
    x, y, z = point
    return ACROSS * (x + y), z - DEEP * (x - y)


def _arrow(look: str, begin: str, end: str, told: str) -> str:
    (x0, y0), (x1, y1) = (tuple(map(float, one.split())) for one in (begin, end))
    length = math.hypot(x1 - x0, y1 - y0)
    if length < 0.5:
        return ""
    ux, uy, head = (x1 - x0) / length, (y1 - y0) / length, min(7.0, length / 2)
    left, right = ((x1 - head * ux + s * 0.5 * head * uy, y1 - head * uy - s * 0.5 * head * ux) for s in (1, -1))
    return (
        f'<path class="arrow {look}" d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}M{left[0]:.1f} {left[1]:.1f}L{x1:.1f} {y1:.1f}'
        f'L{right[0]:.1f} {right[1]:.1f}">{told}</path>'
    )


WIDE, HIGH = 220.0, 28.0  # of an error
SPARK = 120.0
PRIOR = 170.0
EDGE = 6.0  # beside the axis, so that no mark is cut


def place(axis: Axis, value: float, width: float = WIDE) -> float:
    """Return where a value is along a strip, pixels."""
    return round(EDGE + min(max(axis.share(value), 0.0), 1.0) * (width - 2 * EDGE), 1)


def ruler(axis: Axis) -> Markup:
    """Draw the numbers of the shared axis, for the head of the column."""
    ticks = axis.ticks()
    anchors = ["start", *["middle"] * (len(ticks) - 2), "end"]  # what stands at an end is not cut
    parts = [
        f'<text x="{place(axis, at)}" y="18" font-size="11" text-anchor="{anchor}">{escape(text)}</text>'
        for (at, text), anchor in zip(ticks, anchors, strict=False)
    ]
    return whole_svg(WIDE, HIGH, parts, f"Axis: {axis.label}")


def error(axis: Axis, mean: float, low: float, high: float, tolerance: float | None, look: str, title: str) -> Markup:
    """Draw an error with its interval, the decades behind it, and the tolerance as a line."""
    parts = [f'<path class="decade" d="M{place(axis, at)} 0V{HIGH:g}"/>' for at, _ in axis.ticks()]
    if tolerance is not None:
        parts.append(f'<path class="tolerance" d="M{place(axis, tolerance)} 0V{HIGH:g}"/>')
    middle = HIGH / 2
    parts.append(f'<path class="whisker {look}" d="M{place(axis, low)} {middle:g}H{place(axis, high)}"/>')
    parts.append(f'<circle class="dot {look}" cx="{place(axis, mean)}" cy="{middle:g}" r="4.5"/>')
    return whole_svg(WIDE, HIGH, parts, title)


def against_prior(change: float, low: float, high: float, prior: float, title: str) -> Markup:
    """Draw a change with its interval over what was known before: a band of one standard deviation about nominal."""
    axis = Axis("", -1.2 * prior, 1.2 * prior)
    left, right, middle = place(axis, -prior, PRIOR), place(axis, prior, PRIOR), HIGH / 2
    return whole_svg(
        PRIOR,
        HIGH,
        [
            f'<rect class="prior" x="{left}" y="4" width="{round(right - left, 1)}" height="{HIGH - 8:g}"/>',
            f'<path class="decade" d="M{place(axis, 0.0, PRIOR)} 0V{HIGH:g}"/>',
            f'<path class="whisker" d="M{place(axis, low, PRIOR)} {middle:g}H{place(axis, high, PRIOR)}"/>',
            f'<circle class="dot" cx="{place(axis, change, PRIOR)}" cy="{middle:g}" r="4"/>',
        ],
        title,
    )


def spark(days: Sequence[float], means: Sequence[float], marks: Sequence[float], title: str) -> Markup:
    """Draw the last errors over time, by their logarithms, with activations as ticks below."""
    shown = [math.log10(max(mean, 1e-9)) for mean in means]
    low, high = min(shown), max(max(shown), min(shown) + 0.3)
    begin, end = min(days), max(*days, min(days) + 1.0)

    def across(day: float) -> float:
        return round(4 + (day - begin) / (end - begin) * (SPARK - 8), 1)

    points = [
        (across(day), round(HIGH - 7 - (one - low) / (high - low) * (HIGH - 11), 1))
        for day, one in zip(days, shown, strict=True)
    ]
    parts = [f'<polyline points="{" ".join(f"{x},{y}" for x, y in points)}" class="spark"/>']
    parts.append(f'<circle class="dot" cx="{points[-1][0]}" cy="{points[-1][1]}" r="3"/>')
    parts += [f'<path class="mark" d="M{across(day)} {HIGH:g}v-5"/>' for day in marks if begin <= day <= end]
    return whole_svg(SPARK, HIGH, parts, title)
