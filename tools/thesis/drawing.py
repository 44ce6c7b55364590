"""Pictures of the experiments as SVG; the same numbers give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kilter_core.types import Floats

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
STEADY: Any = {
    "svg.hashsalt": "kilter", "svg.fonttype": "none", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3,
    "axes.axisbelow": True,
}  # fmt: skip
COLOURS = ("#1f2933", "#0b63a5", "#c2410c", "#15803d", "#7c3aed", "#a16207")


def bars(name: str, title: str, unit: str, groups: Mapping[str, Mapping[str, Floats]], log: bool = False) -> None:
    """Medians of samples as bars with their whole range, by group and by label."""
    labels = list(next(iter(groups.values())))
    with rc_context(STEADY):
        figure = Figure(figsize=(7.0, 3.8), layout="constrained")
        axes = figure.add_subplot()
        width = 0.8 / len(groups)
        for k, (group, samples) in enumerate(groups.items()):
            middle = np.array([np.median(samples[label]) for label in labels])
            low, high = (np.array([end(samples[label]) for label in labels]) for end in (np.min, np.max))
            places = np.arange(len(labels)) + (k - (len(groups) - 1) / 2) * width
            spread = [middle - low, high - middle]
            axes.bar(places, middle, width, yerr=spread, color=COLOURS[k + 1], label=group or None, capsize=2)
        axes.set_xticks(range(len(labels)), labels, rotation=30, ha="right", fontsize=8)
        axes.set_ylabel(unit)
        if log:
            axes.set_yscale("log")
        _finish(figure, axes, name, title, len(groups) > 1)


def lines(name: str, title: str, x_name: str, unit: str, x: Floats, curves: Mapping[str, Floats], log: bool) -> None:
    """Curves over one abscissa."""
    with rc_context(STEADY):
        figure = Figure(figsize=(7.0, 3.8), layout="constrained")
        axes = figure.add_subplot()
        for colour, (label, curve) in zip(COLOURS, curves.items(), strict=False):
            axes.plot(x, curve, color=colour, label=label, linewidth=1.2)
        axes.set_xlabel(x_name)
        axes.set_ylabel(unit)
        if log:
            axes.set_yscale("log")
        _finish(figure, axes, name, title, True)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    cells = [list(head), ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def _finish(figure: Figure, axes: Any, name: str, title: str, legend: bool) -> None:
    axes.set_title(title)
    if legend:
        axes.legend(fontsize=8)
    figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})


def spread(samples: Floats) -> str:
    """Median and range."""
    return f"{np.median(samples):.3f} ({samples.min():.3f}–{samples.max():.3f})"
