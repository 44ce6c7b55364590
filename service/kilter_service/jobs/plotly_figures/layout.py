"""What the figures of every job share: layouts, colours, bounds, and captions that say where a figure comes from.

Residuals as arrows where the tool was: in space, and from three sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import evenly
from kilter_core.types import Floats
from kilter_service.ground.wire import to_mm

if TYPE_CHECKING:
    from kilter_core.identify import RowErrors


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


MOST_ARROWS, REDDEST = 250, 10
SHARE = 0.12  # of the workspace that a large residual is drawn as
LONGEST_ARROWS = 0.35  # of the workspace that any is drawn as: one wrong row must not make all the others dots
HEAD, HEAD_ANGLE = 0.25, 0.45  # share of an arrow that its barbs take, and their angle, rad
VIEWS = ((0, 1, "from above"), (0, 2, "from the side"), (1, 2, "from the front"))
AXES = "xyz"


def arrows(errors: RowErrors, kind: str) -> dict[str, Document]:
    """Draw what the identified model leaves of rows, at most some hundred: the worst, and others evenly chosen."""
    if errors.rows is None or errors.at is None:
        return {}
    left = errors.left["identified"]
    seen = np.flatnonzero(~np.isnan(left).any(axis=1))
    if not len(seen):
        return {}
    left, at = left[seen], errors.at[seen]
    size = np.linalg.norm(left, axis=1)
    worst = np.argsort(-size, kind="stable")[:REDDEST]
    some = np.union1d(evenly(len(left), MOST_ARROWS), worst)
    red = np.isin(some, worst) & (len(left) > 2 * REDDEST)
    span = float(np.ptp(at, axis=0).max()) or 1.0
    times = magnification(size, span)
    cut = np.minimum(1.0, LONGEST_ARROWS * span / np.maximum(times * size, 1e-12))
    tails, heads = to_mm(at[some]), to_mm((at + (times * cut)[:, None] * left)[some])
    number = f"{len(some)} of {len(left)}" if len(some) < len(left) else str(len(left))
    title = f"Residuals of {number} {kind} rows, {times:g} times as long as they are"
    if np.any(cut < 1.0):
        title += f", the {np.count_nonzero(cut < 1.0)} longest cut short"
    return {
        "residual_arrows_3d": {"data": _in_space(tails, heads, red), "layout": _space(title)},
        "residual_arrows": {"data": _from_three_sides(tails, heads, red), "layout": _sides(title)},
    }


def magnification(size: Floats, span: float) -> float:
    """Return 1, 2 or 5 times a power of ten that makes large residuals a visible part of the workspace."""
    large = float(np.percentile(size, 95))
    wanted = SHARE * span / large if large > 0.0 else 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(k for k in (5.0, 2.0, 1.0) if k * power <= wanted * (1 + 1e-9)) * power)


def _in_space(tails: Floats, heads: Floats, red: Any) -> list[Document]:
    def lines(which: Any, name: str, colour: str) -> Document:
        path = _paths(np.stack([tails[which], heads[which]], axis=1))
        x, y, z = (_numbers(path[:, k]) for k in range(3))
        return {
            "type": "scatter3d",
            "mode": "lines",
            "name": name,
            "x": x,
            "y": y,
            "z": z,
            "line": {"color": colour, "width": 3},
        }

    x, y, z = (_numbers(tails[:, k]) for k in range(3))
    dots = {
        "type": "scatter3d",
        "mode": "markers",
        "name": "where the tool was",
        "x": x,
        "y": y,
        "z": z,
        "marker": {"color": GREY, "size": 5},
    }
    made = [dots, lines(~red, "measured minus predicted", BLUE)]
    return made + ([lines(red, f"the {int(red.sum())} worst", RED)] if red.any() else [])


def _space(title: str) -> Document:
    scene: Document = {f"{axis}axis": {"title": {"text": f"{axis} of the base, mm"}} for axis in AXES}
    return {
        "title": {"text": title},
        "scene": scene | {"aspectmode": "data"},
        "width": 900,
        "height": 760,
        "margin": {"t": 90},
        "legend": LEGEND | {"y": 0.0},
    }


def _from_three_sides(tails: Floats, heads: Floats, red: Any) -> list[Document]:
    data: list[Document] = []
    for n, (i, j, _) in enumerate(VIEWS):
        axes = {} if n == 0 else {"xaxis": f"x{n + 1}", "yaxis": f"y{n + 1}"}
        flat_tails, flat_heads = tails[:, [i, j]], heads[:, [i, j]]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "where the tool was",
                "showlegend": n == 0,
                **axes,
                "x": _numbers(flat_tails[:, 0]),
                "y": _numbers(flat_tails[:, 1]),
                "marker": {"color": GREY, "size": 4},
            }
        )
        for which, name, colour in (
            (~red, "measured minus predicted", BLUE),
            (red, f"the {int(red.sum())} worst", RED),
        ):
            if which.any():
                path = _paths(_arrow_polylines(flat_tails[which], flat_heads[which]))
                data.append(
                    {
                        "type": "scatter",
                        "mode": "lines",
                        "name": name,
                        "showlegend": n == 0,
                        **axes,
                        "x": _numbers(path[:, 0]),
                        "y": _numbers(path[:, 1]),
                        "line": {"color": colour, "width": 1.2},
                    }
                )
    return data


def _sides(title: str) -> Document:
    made: Document = {
        "title": {"text": title},
        "width": 1300,
        "height": 560,
        "margin": {"t": 90},
        "legend": LEGEND,
    }
    for n, (i, j, side) in enumerate(VIEWS):
        own = "" if n == 0 else str(n + 1)
        made[f"xaxis{own}"] = {
            "title": {"text": f"{AXES[i]}, mm ({side})"},
            "domain": [0.355 * n, 0.355 * n + 0.29],
            "anchor": f"y{own}",
        }
        made[f"yaxis{own}"] = {
            "title": {"text": f"{AXES[j]}, mm"},
            "scaleanchor": f"x{own}",
            "scaleratio": 1,
            "anchor": f"x{own}",
        }
    return made


def _arrow_polylines(tails: Floats, heads: Floats) -> Floats:
    """Arrows (N, 5, 2): the shaft, then both barbs of its head."""
    back = HEAD * (tails - heads)
    c, s = np.cos(HEAD_ANGLE), np.sin(HEAD_ANGLE)
    barbs = [heads + back @ np.array([[c, side * s], [-side * s, c]]) for side in (1.0, -1.0)]
    return np.stack([tails, heads, barbs[0], heads, barbs[1]], axis=1)


def _paths(lines: Floats) -> Floats:
    """Lines (N, k, d) one after another with a gap between them, (N (k + 1), d)."""
    gap = np.full((len(lines), 1, lines.shape[2]), np.nan)
    return np.concatenate([lines, gap], axis=1).reshape(-1, lines.shape[2])


def _numbers(values: Floats) -> list[float | None]:
    return [None if np.isnan(v) else round(float(v), 2) for v in values]
