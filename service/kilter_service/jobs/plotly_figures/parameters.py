"""What an identification changed, parameter by parameter, with its 95 % interval: a panel for each unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_service.jobs.plotly_figures.layout import BLUE, FRAME_PX, GREY, RED, ROW_PX, Document, distinct_labels

FRAMES = ("base_", "tool_")
LEARNED = "residual_"  # weights of a learned function: no physics, and hundreds of them
MOST_PARAMETERS = 60
QUANTILE = 1.96
GAP_ROWS = 3.5  # height between two panels, in bars
KINDS = (("seen by these poses", BLUE), ("outside its physical range", RED), ("not seen by these poses", GREY))
Row = Mapping[str, Any]


def changes(parameters: Sequence[Row]) -> Document | None:
    """Draw the changes of parameters; base and tool say where the instrument is: they are drawn only alone."""
    rows = [p for p in parameters if p["value"] is not None and not str(p["name"]).startswith(LEARNED)]
    own = [p for p in rows if not str(p["name"]).startswith(FRAMES)]
    rows = own or rows
    if not rows:
        return None
    drawn = _most_telling(rows)
    units = list(dict.fromkeys(str(p["unit"]) for p in drawn))
    panels = [[p for p in drawn if p["unit"] == unit] for unit in units]
    number = f"{len(drawn)} of {len(rows)}" if len(drawn) < len(rows) else str(len(rows))
    made = _layout(f"What the identification changed: {number} parameters, 95 % intervals", units, panels)
    return {"data": [trace for n, panel in enumerate(panels) for trace in _bars(panel, n, drawn)], "layout": made}


def _most_telling(rows: Sequence[Row]) -> list[Row]:
    """The parameters that are surest to have changed, in their own order."""
    ranked = sorted(rows, key=lambda p: (not p["identifiable"], -abs(_change(p)) / (p["sigma"] or 1e-30)))
    kept = {id(p) for p in ranked[:MOST_PARAMETERS]}
    return [p for p in rows if id(p) in kept]


def _change(p: Row) -> float:
    return float(p["value"]) - float(p["nominal"])


def _kind(p: Row) -> str:
    if not p["identifiable"]:
        return KINDS[2][0]
    return KINDS[0][0] if p["plausible"] else KINDS[1][0]


def _interval(p: Row) -> tuple[float, float]:
    """How far (below, above) the change the interval goes; nothing where the poses say nothing."""
    if not p["identifiable"] or p["sigma"] is None:
        return 0.0, 0.0
    if p.get("lower") is not None:
        return float(p["value"] - p["lower"]), float(p["upper"] - p["value"])
    return QUANTILE * p["sigma"], QUANTILE * p["sigma"]


def _bars(panel: Sequence[Row], n: int, drawn: Sequence[Row]) -> list[Document]:
    """One trace for each kind that is in the panel, over all its names so that their order stays."""
    axes = {} if n == 0 else {"xaxis": f"x{n + 1}", "yaxis": f"y{n + 1}"}
    names = distinct_labels([str(p["name"]) for p in panel])
    out = []
    for kind, colour in KINDS:
        own = [_kind(p) == kind for p in panel]
        if not any(own):
            continue
        ends = [_interval(p) for p in panel]
        first = next(p for p in drawn if _kind(p) == kind)
        out.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": kind,
                "legendgroup": kind,
                "showlegend": first in panel,
                **axes,
                "y": names,
                "x": [_digits(_change(p)) if mine else None for p, mine in zip(panel, own, strict=True)],
                "marker": {"color": colour},
                "error_x": {
                    "type": "data",
                    "symmetric": False,
                    "thickness": 1.2,
                    "color": "#202124",
                    "array": [_digits(above) if mine else None for (_, above), mine in zip(ends, own, strict=True)],
                    "arrayminus": [
                        _digits(below) if mine else None for (below, _), mine in zip(ends, own, strict=True)
                    ],
                },
            }
        )
    return out


def _digits(value: float) -> float:
    return float(f"{value:.5g}")


def _layout(title: str, units: Sequence[str], panels: Sequence[Sequence[Row]]) -> Document:
    """Panels one below the other, as high as they have bars."""
    heights = [float(len(panel)) for panel in panels]
    whole = sum(heights) + GAP_ROWS * (len(panels) - 1)
    made: Document = {
        "title": {"text": title},
        "barmode": "overlay",
        "height": round(FRAME_PX + ROW_PX * max(4.0, whole)),
        "margin": {"t": 110},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.0},
    }
    top = 1.0
    for n, (unit, height) in enumerate(zip(units, heights, strict=True)):
        own, low = "" if n == 0 else str(n + 1), max(0.0, top - height / whole)
        made[f"xaxis{own}"] = {
            "title": {"text": f"change, {unit}" if unit else "change"},
            "anchor": f"y{own}",
            "zeroline": True,
        }
        made[f"yaxis{own}"] = {
            "title": {"text": ""},
            "domain": [low, top],
            "anchor": f"x{own}",
            "automargin": True,
            "type": "category",
            "autorange": "reversed",
        }
        top = low - GAP_ROWS / whole
    return made
