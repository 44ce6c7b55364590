"""Figures of a job as files: Plotly's JSON as it came, and PNG and SVG drawn by matplotlib where it is installed.

Only what Kilter's figures hold is drawn: scatters, bars with error bars, heat maps, titles and axis names.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kilter_client.errors import FileError, MissingPackageError

INCH = (7.0, 4.2)
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
            "PNG and SVG need matplotlib: pip install 'kilter-client[plots]'. The Plotly JSON needs nothing.",
            package="matplotlib",
        ) from error
    with rc_context(STEADY):
        canvas = Figure(figsize=INCH, layout="constrained")
        axes = canvas.add_subplot()
        _fill(canvas, axes, figure)
        files = [stem.with_name(f"{stem.name}.{form}") for form in formats]
        for file in files:
            canvas.savefig(file, dpi=DPI, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files


def _fill(canvas: Any, axes: Any, figure: Mapping[str, Any]) -> None:
    layout, traces = figure["layout"], figure["data"]
    axes.set_title(layout["title"]["text"])
    axes.set_xlabel(layout["xaxis"]["title"]["text"])
    axes.set_ylabel(layout["yaxis"]["title"]["text"])
    bars = [trace for trace in traces if trace["type"] == "bar"]
    for trace in traces:
        if trace["type"] == "scatter":
            _scatter(axes, trace)
        elif trace["type"] == "heatmap":
            _heatmap(canvas, axes, trace)
    if bars:
        _bars(axes, bars)
    if len(traces) > 1:
        axes.legend(fontsize=8)


def _scatter(axes: Any, trace: Mapping[str, Any]) -> None:
    marker = trace.get("marker", {})
    axes.scatter(
        trace["x"], trace["y"], s=marker.get("size", 4) ** 2 / 2, c=marker.get("color"), label=trace["name"],
        linewidths=0, rasterized=True,
    )  # fmt: skip


def _bars(axes: Any, traces: list[Mapping[str, Any]]) -> None:
    names = [str(name) for name in traces[0]["x"]]
    width = 0.8 / len(traces)
    for k, trace in enumerate(traces):
        places = [i + (k - (len(traces) - 1) / 2) * width for i in range(len(names))]
        spread = trace.get("error_y", {}).get("array")
        colour = trace.get("marker", {}).get("color")
        axes.bar(places, trace["y"], width, yerr=spread, color=colour, label=trace.get("name"), capsize=2)
    _names(axes, names)


def _heatmap(canvas: Any, axes: Any, trace: Mapping[str, Any]) -> None:
    image = axes.imshow(trace["z"], vmin=trace.get("zmin"), vmax=trace.get("zmax"), cmap=trace.get("colorscale"))
    canvas.colorbar(image, ax=axes)
    axes.grid(False)
    _names(axes, [str(name) for name in trace["x"]])
    axes.set_yticks(range(len(trace["y"])), [str(name) for name in trace["y"]], fontsize=6)


def _names(axes: Any, names: list[str]) -> None:
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right", fontsize=7 if len(names) < 12 else 6)
