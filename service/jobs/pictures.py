"""The figures of a gap hunt as Plotly documents: {"data": [...], "layout": {...}}."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Document = dict[str, Any]

GREY, BLUE, RED, GREEN = "#9aa0a6", "#1f6fb2", "#c0392b", "#2e8b57"


def pictures(report: Mapping[str, Any]) -> dict[str, Document]:
    """Draw a gap report: the gap bar, residuals by angle, direction and load, contributions, the alias matrix."""
    numbers = report["figures"]
    unit = "deg" if "before_deg" in report["gap"] else "mm"
    drawn = {"gap_bar": _gap_bar(numbers["gap_bar"], unit)}
    drawn |= {f"residual_joint_{one['joint']}": _by_angle(one, unit) for one in numbers["residual_by_angle"]}
    if numbers["residual_by_direction"]:
        drawn["residual_by_direction"] = _by_label(
            numbers["residual_by_direction"], "Direction of the last motion", unit
        )
    if numbers["residual_by_load"]:
        drawn["residual_by_load"] = _by_label(numbers["residual_by_load"], "Payload, kg", unit)
    if numbers["contribution"]:
        drawn["contribution"] = _contribution(numbers["contribution"], unit)
    if report["alias_matrix"]["labels"]:
        drawn["alias_matrix"] = _aliases(report["alias_matrix"])
    return drawn


def _layout(title: str, x: str, y: str) -> Document:
    return {"title": {"text": title}, "xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}


def _gap_bar(bars: Sequence[Mapping[str, Any]], unit: str) -> Document:
    colours = [RED, *[BLUE] * (len(bars) - 2), GREY]
    trace = {
        "type": "bar", "x": [b["label"] for b in bars], "y": [b["value"] for b in bars], "marker": {"color": colours},
    }  # fmt: skip
    return {"data": [trace], "layout": _layout("The gap, step by step", "", f"rms error, {unit}")}


def _by_angle(one: Mapping[str, Any], unit: str) -> Document:
    def points(name: str, y: str, colour: str, mode: str = "markers") -> Document:
        look = {"marker": {"color": colour, "size": 4}} if mode == "markers" else {"line": {"color": colour}}
        return {"type": "scatter", "mode": mode, "name": name, "x": one["q_deg"], "y": one[y], **look}

    data = [points("before", "before", GREY), points("after", "after", BLUE)]
    if any(one["curve"]):
        data.append(points("fitted", "curve", RED, "markers"))
    title = f"Residual along what joint {one['joint']} moves"
    return {"data": data, "layout": _layout(title, f"joint {one['joint']}, deg", f"residual, {unit}")}


def _by_label(rows: Sequence[Mapping[str, Any]], title: str, unit: str) -> Document:
    names = [("" if r["joint"] is None else f"j{r['joint']}: ") + f"{r['value']:g}" for r in rows]

    def bars(name: str, colour: str) -> Document:
        spread = {"type": "data", "array": [r[f"{name}_sd"] for r in rows]}
        return {
            "type": "bar", "name": name, "x": names, "y": [r[f"{name}_mean"] for r in rows], "error_y": spread,
            "marker": {"color": colour},
        }  # fmt: skip

    layout = _layout(f"Residual by {title[0].lower()}{title[1:]}", title, f"residual, {unit}")
    return {"data": [bars("before", GREY), bars("after", BLUE)], "layout": layout | {"barmode": "group"}}


def _contribution(rows: Sequence[Mapping[str, Any]], unit: str) -> Document:
    def bars(name: str, colour: str) -> Document:
        return {
            "type": "bar", "name": name, "x": [r["label"] for r in rows], "y": [r[name] for r in rows],
            "marker": {"color": colour},
        }  # fmt: skip

    layout = _layout("Displacement by each named effect", "", unit)
    return {"data": [bars("rms", GREEN), bars("largest", GREY)], "layout": layout | {"barmode": "group"}}


def _aliases(matrix: Mapping[str, Any]) -> Document:
    trace = {
        "type": "heatmap", "x": matrix["labels"], "y": matrix["labels"], "z": matrix["values"], "zmin": 0, "zmax": 1,
        "colorscale": "Blues",
    }  # fmt: skip
    return {"data": [trace], "layout": _layout("How alike signatures are after the geometry is fitted", "", "")}
