"""Points in space with arrows, seen from the side and above: drawn without a browser's help, so that it prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from kilter_service.page.figures.room import room_for
from kilter_service.page.words import mm

Point = Sequence[float]
ACROSS, DEEP = math.cos(math.radians(25)), math.sin(math.radians(25))
EDGE, CELLS, LONGEST = 34.0, 6, 0.22  # pixels beside it, cells of the ground, length of the longest arrow by its size


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
        tips = {kind.look: [self._tip(at, one, times) for at, one in zip(self.at, kind.vectors, strict=True)]
                for kind in self.arrows}  # fmt: skip
        corners = [(sx * reach, sy * reach, ground) for sx in (-1, 1) for sy in (-1, 1)]
        flat = [_flat(one) for one in (*self.at, *corners, *(tip for own in tips.values() for tip in own if tip))]
        width = room_for(self.width)
        scale = min(
            (width - 2 * EDGE) / (max(x for x, _ in flat) - min(x for x, _ in flat)),
            (self.height - 2 * EDGE) / (max(y for _, y in flat) - min(y for _, y in flat)),
        )
        left, top = min(x for x, _ in flat), max(y for _, y in flat)
        aside = (width - scale * (max(x for x, _ in flat) - left)) / 2

        def place(one: Point) -> str:
            x, y = _flat(one)
            return f"{aside + scale * (x - left):.1f} {EDGE + scale * (top - y):.1f}"

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
            f'<g transform="translate({EDGE + 150 * k:g} 14)">{_arrow(kind.look, "0 0", "24 0", "")}'
            f'<text x="32" y="4">{escape(kind.label)}</text></g>'
            for k, kind in enumerate(self.arrows)
        )
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {self.height:g}" width="{width:g}" '
            f'height="{self.height:g}" role="img" class="space" font-size="12" fill="currentColor">'
        )
        said = f"<title>{escape(self.title)}</title><desc>{len(self.at)} points; arrows are drawn {times} times as long.</desc>"
        return Markup(f"{head}{said}{keys}{''.join(parts)}</svg>")  # noqa: S704 (texts are escaped above)

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
