"""What the figures of every job share: layouts, colours, bounds, and captions that say where a figure comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from kilter_core.types import Floats

Document = dict[str, Any]

GREY, BLUE, RED, GREEN, ORANGE = "#9aa0a6", "#1f6fb2", "#c0392b", "#2e8b57", "#d98324"

LEGEND: Document = {"orientation": "h", "yanchor": "top", "y": -0.22, "itemsizing": "constant"}

LONGEST = 34  # letters of a label or a name; what is longer loses its middle
MOST_CAMPAIGNS = 3
ROW_PX, FRAME_PX = 22, 190  # height of a bar with its label, and of everything round the bars


def layout(title: str, x: str, y: str, **more: Any) -> Document:
    """Return a layout with a title and two named axes."""
    axes = {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}, "automargin": True}}
    return {"title": {"text": title}, **axes, "margin": {"t": 90}, "legend": LEGEND, **more}


def bar_layout(title: str, x: str, labels: Sequence[str], each: int = 1, **more: Any) -> Document:
    """Return the layout of horizontal bars, ``each`` so many to a label, the first on top, labels clear of each other."""
    height = FRAME_PX + round(ROW_PX * max(4, len(labels)) * (0.6 + 0.4 * each))
    made = layout(title, x, "", height=height, **more)
    made["legend"] = LEGEND | {"y": -70 / (height - FRAME_PX)}
    made["yaxis"] |= {"autorange": "reversed", "type": "category"}
    return made


def shorten_label(text: str, longest: int = LONGEST) -> str:
    """Return a text with its middle left out where it is too long for a label."""
    if len(text) <= longest:
        return text
    end = (longest - 1) // 3
    return f"{text[: longest - 1 - end]}…{text[-end:]}"


def plain_text(text: str) -> str:
    """Return a name as Plotly shows it: no marks, and no mathematics between two dollars."""
    return escape(text).replace("$", "&#36;")


def distinct_labels(labels: Sequence[str]) -> list[str]:
    """Return shortened labels; equal ones are numbered, because they would become one bar."""
    seen: dict[str, int] = {}
    out = []
    for label in map(shorten_label, labels):
        seen[label] = seen.get(label, 0) + 1
        out.append(label if seen[label] == 1 else f"{label} ({seen[label]})")
    return out


def round_values(values: Floats, digits: int = 4) -> list[float | None]:
    """Return numbers short enough for a figure, None where there is none."""
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]


def three_digits(value: float) -> str:
    """Return a number with three digits, never with an exponent people must read."""
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def add_captions(figures: Mapping[str, Document], robot: str, campaigns: Sequence[str], version: str) -> Any:
    """Return the figures with robot, campaigns and version under their titles and in ``layout.meta``."""
    meta = {"robot": robot, "campaigns": list(campaigns), "version": version}
    named = ", ".join(shorten_label(name) for name in campaigns[:MOST_CAMPAIGNS])
    more = f" and {len(campaigns) - MOST_CAMPAIGNS} more" if len(campaigns) > MOST_CAMPAIGNS else ""
    under = (
        f"<br><sup>{plain_text(shorten_label(robot))}, version {version}<br>measured: {plain_text(named)}{more}</sup>"
    )
    return {
        name: {
            **figure,
            "layout": {
                **figure["layout"],
                "meta": meta,
                "title": {"text": figure["layout"]["title"]["text"] + under},
            },
        }
        for name, figure in figures.items()
    }
