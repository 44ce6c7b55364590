"""Figures of a job as files: Plotly's JSON as it came, and PNG and SVG drawn by matplotlib where it is installed.

Only what Kilter's figures hold is drawn: points, lines, bars with error bars, heat maps, side by side or in space.
"""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Mapping, Sequence
from html import unescape
from pathlib import Path
from typing import Any

from kilter_client.errors import FileError, MissingPackageError

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
        *points,
        s=(DOT * 1.4 * marker.get("size", 4)) ** 2,
        label=trace.get("name"),
        marker=symbol,
        linewidths=SYMBOL_LINE if lined else 0,
        **colour,
        **({} if len(points) == 3 else {"rasterized": True}),
    )
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


INCH = (7.5, 4.6)
PX = 100  # of a layout's width and height to the inch
LETTERS_TO_THE_INCH, SAMPLE_LETTERS = 14, 8  # of a legend, and what the sample before a name takes
DPI = 120
# The same figure gives the same bytes: no date, no random ids.
STEADY: Any = {
    "svg.hashsalt": "kilter",
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.axisbelow": True,
}


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def save_figures(figures: Mapping[str, Mapping[str, Any]], folder: Path, formats: tuple[str, ...]) -> list[Path]:
    """Write every figure as ``NAME.json`` and in ``formats`` (png, svg); returns the files.

    Raises:
        FileError: the folder cannot be written.
        MissingPackageError: formats are asked for and matplotlib is not installed; the JSON files are written.

    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            written.append(folder / f"{name}.json")
            written[-1].write_text(json.dumps(figure), encoding="utf-8")
        for name, figure in figures.items() if formats else ():
            written += draw(figure, folder / name, formats)
    except OSError as error:
        raise FileError(f"{folder}: figures cannot be written: {error.strerror or error}.", file=str(folder)) from error
    return written


def draw(figure: Mapping[str, Any], stem: Path, formats: tuple[str, ...]) -> list[Path]:
    """Draw one figure to ``stem.png``, ``stem.svg``.

    Raises:
        MissingPackageError: matplotlib is not installed.

    """
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingPackageError(
            "PNG and SVG need matplotlib: pip install matplotlib.",
            package="matplotlib",
        ) from error
    with rc_context(STEADY):
        canvas = Figure(figsize=_inches(figure["layout"]), layout="constrained")
        _draw_all(canvas, figure)
        files = [stem.with_name(f"{stem.name}.{form}") for form in formats]
        for file in files:
            canvas.savefig(file, dpi=DPI, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files


def _inches(layout: Mapping[str, Any]) -> tuple[float, float]:
    """Size of a picture: as the layout wants it, else the usual one."""
    width, height = layout.get("width"), layout.get("height")
    return width / PX if width else INCH[0], height / PX if height else INCH[1]


def _draw_all(canvas: Any, figure: Mapping[str, Any]) -> None:
    layout, traces = figure["layout"], figure["data"]
    title, *under = words(layout["title"]["text"]).split("\n")
    canvas.suptitle("\n".join([title, *under]), fontsize=10)
    pairs = list(dict.fromkeys((trace.get("xaxis", "x"), trace.get("yaxis", "y")) for trace in traces))
    flat = [trace for trace in traces if trace["type"] != "scatter3d"]
    if not flat:
        _in_space(canvas, traces, layout)
    grid = _grid(canvas, layout, pairs) if flat else {}
    for pair, axes in grid.items():
        own = [trace for trace in flat if (trace.get("xaxis", "x"), trace.get("yaxis", "y")) == pair]
        _name_axes(axes, layout, pair)
        fill(canvas, axes, own, layout)
    _legend(canvas, traces)


def _in_space(canvas: Any, traces: Sequence[Mapping[str, Any]], layout: Mapping[str, Any]) -> None:
    axes = canvas.add_subplot(projection="3d")
    for letter in "xyz":
        getattr(axes, f"set_{letter}label")(words(layout["scene"][f"{letter}axis"]["title"]["text"]))
    fill(canvas, axes, traces, layout)
    axes.set_aspect("equal")


def _grid(canvas: Any, layout: Mapping[str, Any], pairs: Sequence[tuple[str, str]]) -> dict[tuple[str, str], Any]:
    """Axes where the layout's domains put them: side by side, or one below the other."""
    across = sorted({_domain(layout, x)[0] for x, _ in pairs})
    down = sorted({_domain(layout, y)[0] for _, y in pairs}, reverse=True)
    sizes = {_domain(layout, y)[0]: _domain(layout, y)[1] - _domain(layout, y)[0] for _, y in pairs}
    cells = canvas.add_gridspec(len(down), len(across), height_ratios=[sizes[low] for low in down])
    return {
        (x, y): canvas.add_subplot(cells[down.index(_domain(layout, y)[0]), across.index(_domain(layout, x)[0])])
        for x, y in pairs
    }


def _axis(layout: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Layout of an axis by the name traces give it: "x2" is "xaxis2"."""
    found: Mapping[str, Any] = layout[f"{name[0]}axis{name[1:]}"]
    return found


def _domain(layout: Mapping[str, Any], name: str) -> tuple[float, float]:
    low, high = _axis(layout, name).get("domain", (0.0, 1.0))
    return float(low), float(high)


def _name_axes(axes: Any, layout: Mapping[str, Any], pair: tuple[str, str]) -> None:
    x, y = (_axis(layout, name) for name in pair)
    axes.set_xlabel(words(x["title"]["text"]))
    axes.set_ylabel(words(y["title"]["text"]))
    if x.get("type") == "log":
        axes.set_xscale("log")
    if x.get("zeroline"):
        axes.axvline(0.0, color="#5f6368", linewidth=0.8)
    for axis, limit in ((x, axes.set_xlim), (y, axes.set_ylim)):
        if "range" in axis:
            limit(*axis["range"])
    if y.get("scaleanchor"):
        axes.set_aspect("equal", adjustable="box" if "range" in y else "datalim")


def _legend(canvas: Any, traces: Sequence[Mapping[str, Any]]) -> None:
    """One legend below all axes, each name once."""
    named = {str(trace["name"]) for trace in traces if trace.get("name") and trace.get("showlegend", True)}
    found = {
        label: handle for axes in canvas.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    shown = {label: handle for label, handle in found.items() if label in named}
    if not shown or (len(named) < 2 and not any(trace.get("showlegend") for trace in traces)):
        return
    fitting = int(canvas.get_figwidth() * LETTERS_TO_THE_INCH / (max(map(len, shown)) + SAMPLE_LETTERS))
    canvas.legend(
        shown.values(), map(words, shown), loc="outside lower center", ncols=min(max(1, fitting), 3), fontsize=8
    )
