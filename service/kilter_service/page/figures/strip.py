"""Small drawings for a row of a table: an error on an axis that all rows share, and the last errors as a line."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup, escape

from kilter_service.page.figures.scale import Axis

WIDE, HIGH = 220.0, 28.0  # of an error
SPARK = 120.0
PRIOR = 170.0
EDGE = 6.0  # beside the axis, so that no mark is cut


def _svg(width: float, title: str, parts: Sequence[str]) -> Markup:
    head = f'<svg viewBox="0 0 {width:g} {HIGH:g}" width="{width:g}" height="{HIGH:g}" role="img" fill="currentColor">'
    return Markup(f"{head}<title>{escape(title)}</title>{''.join(parts)}</svg>")  # noqa: S704 (the title is escaped)


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
    return _svg(WIDE, f"Axis: {axis.label}", parts)


def error(axis: Axis, mean: float, low: float, high: float, tolerance: float | None, look: str, title: str) -> Markup:
    """Draw an error with its interval, the decades behind it, and the tolerance as a line."""
    parts = [f'<path class="decade" d="M{place(axis, at)} 0V{HIGH:g}"/>' for at, _ in axis.ticks()]
    if tolerance is not None:
        parts.append(f'<path class="tolerance" d="M{place(axis, tolerance)} 0V{HIGH:g}"/>')
    middle = HIGH / 2
    parts.append(f'<path class="whisker {look}" d="M{place(axis, low)} {middle:g}H{place(axis, high)}"/>')
    parts.append(f'<circle class="dot {look}" cx="{place(axis, mean)}" cy="{middle:g}" r="4.5"/>')
    return _svg(WIDE, title, parts)


def against_prior(change: float, low: float, high: float, prior: float, title: str) -> Markup:
    """Draw a change with its interval over what was known before: a band of one standard deviation about nominal."""
    axis = Axis("", -1.2 * prior, 1.2 * prior)
    left, right, middle = place(axis, -prior, PRIOR), place(axis, prior, PRIOR), HIGH / 2
    return _svg(
        PRIOR,
        title,
        [
            f'<rect class="prior" x="{left}" y="4" width="{round(right - left, 1)}" height="{HIGH - 8:g}"/>',
            f'<path class="decade" d="M{place(axis, 0.0, PRIOR)} 0V{HIGH:g}"/>',
            f'<path class="whisker" d="M{place(axis, low, PRIOR)} {middle:g}H{place(axis, high, PRIOR)}"/>',
            f'<circle class="dot" cx="{place(axis, change, PRIOR)}" cy="{middle:g}" r="4"/>',
        ],
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
    return _svg(SPARK, title, parts)
