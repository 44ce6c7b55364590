"""How much of each joint's range was measured: a bar from limit to limit, darker where there are more rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from kilter_service.page.figures.plot import BLUE, FONT, LETTER
from kilter_service.page.figures.room import room_for

HEIGHT, BAR = 42.0, 16.0
WIDTH, RIGHT = 440.0, 8.0


@dataclass(frozen=True)
class Bar:
    """A joint: its bar from ``low`` to ``high``, counts of rows along it, the span of the readings, and what is said."""

    name: str
    low: float
    high: float
    counts: Sequence[int]
    first: float
    last: float
    said: str


@dataclass(frozen=True)
class Coverage:
    """The bars of all joints."""

    title: str
    bars: Sequence[Bar]
    table: tuple[Sequence[str], Sequence[Sequence[str]]]

    def svg(self) -> Markup:
        """Return it as SVG."""
        width = room_for(WIDTH)
        left = 12 + LETTER * max((len(bar.name) for bar in self.bars), default=0)
        height = HEIGHT * len(self.bars) + 4
        said = "; ".join(f"{bar.name}: {bar.said}" for bar in self.bars)
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" width="{width}" '
            f'height="{height}" {FONT} fill="currentColor"><title>{escape(self.title)}</title><desc>{escape(said)}</desc>'
        )
        body = "".join(self._drawn(bar, left, HEIGHT * k, width - RIGHT - left) for k, bar in enumerate(self.bars))
        return Markup(f"{head}{body}</svg>")  # noqa: S704 (texts are escaped above)

    def _drawn(self, bar: Bar, left: float, top: float, room: float) -> str:
        most = max(bar.counts, default=0) or 1
        step = room / max(len(bar.counts), 1)
        y = top + 18

        def place(value: float) -> float:
            return left + room * (value - bar.low) / (bar.high - bar.low)

        parts = [
            f'<text x="{left - 6:.1f}" y="{y + 12:.1f}" text-anchor="end">{escape(bar.name)}</text>',
            f'<text x="{left:.1f}" y="{y - 5:.1f}" font-size="11">{escape(bar.said)}</text>',
            f'<rect x="{left:.1f}" y="{y:.1f}" width="{room:.1f}" height="{BAR}" fill="none" stroke="currentColor" '
            'stroke-opacity="0.5"/>',
        ]
        for k, count in enumerate(bar.counts):
            if count:
                shade = 0.25 + 0.75 * count / most
                parts.append(
                    f'<rect x="{left + k * step:.1f}" y="{y:.1f}" width="{step:.1f}" height="{BAR}" fill="{BLUE}" '
                    f'fill-opacity="{shade:.2f}"><title>{count} rows</title></rect>'
                )
        for value in (bar.first, bar.last):
            x = place(value)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 2:.1f}" y2="{y + BAR + 2:.1f}" stroke="currentColor" '
                'stroke-width="2"/>'
            )
        return "".join(parts)
