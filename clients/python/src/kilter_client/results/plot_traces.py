"""Plotly traces onto matplotlib axes: what Kilter's figures hold, and no more."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import unescape
from typing import Any

Trace = Mapping[str, Any]

NAN = math.nan
DOT = 0.6  # of Plotly's pixels, in matplotlib's points
STEPS = {"hv": "post", "vh": "pre"}
MARKERS = {"x": "x", "circle-open": "o", "circle": "o", "diamond": "D"}
SYMBOL_LINE = 0.8


def words(text: str) -> str:
    """Plain text of a title: lines for <br>, no other marks, no mathematics in a name with dollars."""
    for mark in ("<sup>", "</sup>", "<b>", "</b>"):
        text = text.replace(mark, "")
    return unescape(text.replace("<br>", "\n")).replace("$", r"\$")


def fill(canvas: Any, axes: Any, traces: Sequence[Trace], layout: Mapping[str, Any]) -> None:
    """Draw the traces of one pair of axes."""
    bars = [trace for trace in traces if trace["type"] == "bar"]
    for trace in traces:
        if trace["type"] in ("scatter", "scatter3d"):
            _scatter(canvas, axes, trace)
        elif trace["type"] == "heatmap":
            _heatmap(canvas, axes, trace)
    if bars:
        _bars(axes, bars, layout.get("barmode", "group") == "overlay")


def _numbers(values: Sequence[Any]) -> list[float]:
    return [NAN if v is None else float(v) for v in values]


def _scatter(canvas: Any, axes: Any, trace: Trace) -> None:
    points = [_numbers(trace[k]) for k in ("x", "y", "z") if k in trace]
    mode = trace["mode"]
    if "lines" in mode:
        _line(axes, points, trace)
    if "markers" in mode:
        _dots(canvas, axes, points, trace)
    for place, text in zip(zip(*points, strict=True), trace.get("text", ()), strict=False):
        axes.annotate(text, place, textcoords="offset points", xytext=(5, 5), fontsize=9, fontweight="bold")


def _line(axes: Any, points: list[list[float]], trace: Trace) -> None:
    line = trace.get("line", {})
    look = {"color": line.get("color"), "linewidth": 0.6 * line.get("width", 2.0)}
    own = {} if "markers" in trace["mode"] else {"label": trace.get("name")}
    if trace.get("fill") == "toself":
        axes.fill(*points, color=line.get("color"), alpha=0.2, linewidth=0)
        return
    step = STEPS.get(line.get("shape", ""))
    if step is None:
        axes.plot(*points, **look, **own)
        return
    axes.step(*points, where=step, **look, **own)
    if trace.get("fill") == "tozeroy":
        axes.fill_between(*points, step=step, color=line.get("color"), alpha=0.25, linewidth=0)


def _dots(canvas: Any, axes: Any, points: list[list[float]], trace: Trace) -> None:
    marker = trace.get("marker", {})
    scale = marker.get("colorscale")
    symbol = MARKERS.get(marker.get("symbol", "circle"), "o")
    colour = {"c": marker["color"], "cmap": scale.lower()} if scale else {"c": marker.get("color")}
    if scale and "cmin" in marker:
        colour |= {"vmin": marker["cmin"], "vmax": marker["cmax"]}
    if str(marker.get("symbol", "")).endswith("-open"):
        colour = {"facecolors": "none", "edgecolors": marker.get("color")}
    lined = symbol == "x" or "facecolors" in colour
    drawn = axes.scatter(
        *points, s=(DOT * 1.4 * marker.get("size", 4)) ** 2, label=trace.get("name"), marker=symbol,
        linewidths=SYMBOL_LINE if lined else 0, **colour, **({} if len(points) == 3 else {"rasterized": True}),
    )  # fmt: skip
    if "colorbar" in marker:
        bar = canvas.colorbar(drawn, ax=canvas.axes, shrink=0.8)
        bar.set_label(words(marker["colorbar"]["title"]["text"]))


def _bars(axes: Any, traces: Sequence[Trace], overlay: bool) -> None:
    lying = traces[0].get("orientation") == "h"
    names = [str(name) for name in traces[0]["y" if lying else "x"]]
    many = 1 if overlay else len(traces)
    width = 0.8 / many
    for k, trace in enumerate(traces):
        offset = 0.0 if overlay else (k - (many - 1) / 2) * width
        places = [i + offset for i in range(len(names))]
        values = _numbers(trace["x" if lying else "y"])
        look = {"color": trace.get("marker", {}).get("color"), "label": trace.get("name"), "capsize": 2}
        if lying:
            axes.barh(places, values, width, xerr=_spread(trace.get("error_x")), **look)
        else:
            axes.bar(places, values, width, yerr=_spread(trace.get("error_y")), **look)
    if lying:
        axes.set_yticks(range(len(names)), [words(name) for name in names])
        axes.set_ylim(len(names) - 0.4, -0.6)
    else:
        _names(axes, names)


def _spread(error: Mapping[str, Any] | None) -> Any:
    if error is None:
        return None
    above = _numbers(error["array"])
    return above if error.get("symmetric", True) else [_numbers(error["arrayminus"]), above]


def _heatmap(canvas: Any, axes: Any, trace: Trace) -> None:
    image = axes.imshow(trace["z"], vmin=trace.get("zmin"), vmax=trace.get("zmax"), cmap=trace.get("colorscale"))
    canvas.colorbar(image, ax=axes)
    axes.grid(False)
    _names(axes, [str(name) for name in trace["x"]])
    axes.set_yticks(range(len(trace["y"])), [words(str(name)) for name in trace["y"]])


def _names(axes: Any, names: list[str]) -> None:
    """Names below the axis, rotated where they would meet."""
    turned = sum(map(len, names)) > 60 or max(map(len, names)) * len(names) > 60
    look: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if turned else {}
    axes.set_xticks(range(len(names)), [words(name) for name in names], **look)
