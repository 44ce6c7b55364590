"""The figures of a gap search as Plotly documents: {"data": [...], "layout": {...}}."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kilter_service.contract.figures import CurveSide, EffectCurve
from kilter_service.jobs import budgets
from kilter_service.jobs.plotly_figures.layout import (
    BLUE,
    FRAME_PX,
    GREEN,
    GREY,
    ORANGE,
    RED,
    ROW_PX,
    Document,
    bar_layout,
    distinct_labels,
    layout,
    three_digits,
)

COLOUR_OF: dict[float | None, str] = {1.0: BLUE, -1.0: ORANGE, 0.0: GREY, None: BLUE}
THIN, BOLD, DOT_PX = 1.0, 2.5, 5


def own_curves(curves: Sequence[dict[str, Any]]) -> dict[str, Document]:
    """Draw every curve of a report, ``effect_curve_backlash_joint_2`` and so on."""
    out: dict[str, Document] = {}
    for one in curves:
        curve = EffectCurve.model_validate(one)
        name = f"effect_curve_{curve.id}_joint_{curve.joint}"
        taken = sum(other == name or other.startswith(f"{name}_again") for other in out)
        title = budgets.title(curve) + _format_direction_gap(curve)
        made = layout(title, budgets.across(curve), budgets.upwards(curve))
        out[name if not taken else f"{name}_again_{taken}"] = {"data": list(_traces(curve)), "layout": made}
    return out


def _traces(curve: EffectCurve) -> Iterator[Document]:
    for side in curve.sides:
        if side.low is not None and side.high is not None:
            yield _band(side, side.low, side.high)
    yield from _visits(curve)
    for place, side in enumerate(curve.rival.sides if curve.rival is not None else []):
        assert curve.rival is not None
        yield _line(side.x, side.y, f"refused: {budgets.format_effect_name(curve.rival)}", RED, THIN, named=not place)
    for side in curve.sides:
        yield _line(side.x, side.y, budgets.model(side.direction), COLOUR_OF[side.direction], BOLD)


def _visits(curve: EffectCurve) -> Iterator[Document]:
    """Dots of the visits, those of each direction apart, and the interval of each as a bar."""
    visits = curve.visits
    sides: list[float | None] = [None] * len(visits.x) if visits.direction is None else [*visits.direction]
    for direction in dict.fromkeys(sides):
        own = [k for k, side in enumerate(sides) if side == direction]
        colour = GREY if direction is None else COLOUR_OF[direction]
        x = [value for k in own for value in (visits.x[k], visits.x[k], None)]
        y = [value for k in own for value in (visits.y[k] - visits.half[k], visits.y[k] + visits.half[k], None)]
        yield _line(x, y, "95 % interval", colour, THIN, named=False)
        yield {
            "type": "scatter",
            "mode": "markers",
            "name": budgets.visit(direction),
            "showlegend": True,
            "x": [visits.x[k] for k in own],
            "y": [visits.y[k] for k in own],
            "marker": {"color": colour, "size": DOT_PX},
        }


def _band(side: CurveSide, low: Sequence[float], high: Sequence[float]) -> Document:
    """The area between both ends of the band, as one closed line."""
    x, y = [*side.x, *reversed(side.x)], [*high, *reversed(low)]
    return {**_line(x, y, "95 % band", COLOUR_OF[side.direction], 0.0, named=False), "fill": "toself"}


def _line(
    x: Sequence[float | None], y: Sequence[float | None], name: str, colour: str, width: float, *, named: bool = True
) -> Document:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "showlegend": named,
        "x": list(x),
        "y": list(y),
        "line": {"color": colour, "width": width},
    }


def _format_direction_gap(curve: EffectCurve) -> str:
    """How far both directions are apart, below the title; nothing where there is one."""
    apart = curve.distance
    if apart is None:
        return ""
    sign = -1.0 if apart.value < 0 else 1.0
    low, high = sorted((sign * apart.low, sign * apart.high))
    said = f"{three_digits(abs(apart.value))} {curve.unit} ({three_digits(low)} to {three_digits(high)})"
    return f"<br><sup>both directions are {said} apart</sup>"


def gap_figures(report: Mapping[str, Any]) -> dict[str, Document]:
    """Draw a gap report: the gap bar, residuals, effects over what they follow, contributions, aliases."""
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
    drawn |= own_curves(report.get("effect_curves") or [])
    if numbers["contribution"]:
        drawn["contribution"] = _contribution(numbers["contribution"], unit)
    if report["alias_matrix"]["labels"]:
        drawn["alias_matrix"] = _aliases(report["alias_matrix"])
    return drawn


def _gap_bar(bars: Sequence[Mapping[str, Any]], unit: str) -> Document:
    """Error after each step; held-out rows beside fitted ones."""
    labels = distinct_labels([bar["label"] for bar in bars])

    def trace(name: str, key: str, colour: str) -> Document:
        return {
            "type": "bar",
            "orientation": "h",
            "name": name,
            "y": labels,
            "x": [bar[key] for bar in bars],
            "marker": {"color": [colour] * (len(bars) - 1) + [GREY]},
            "showlegend": True,
        }

    data = [trace("rows that were fitted", "value", BLUE)]
    if bars[0]["held_out"] is not None:
        data.append(trace("held-out rows", "held_out", ORANGE) | _intervals(bars))
    title = "The gap, step by step: what is left with each effect added to those above it"
    return {"data": data, "layout": bar_layout(title, f"rms error, {unit}", labels, len(data), barmode="group")}


def _intervals(bars: Sequence[Mapping[str, Any]]) -> Document:
    """The 95 % intervals of the held-out errors; of the noise there is none."""
    ends = [bar.get("held_out_interval") for bar in bars]
    if not any(ends):
        return {}
    lengths = [
        (0.0, 0.0) if end is None else (end[1] - bar["held_out"], bar["held_out"] - end[0])
        for bar, end in zip(bars, ends, strict=True)
    ]
    above, below = zip(*lengths, strict=True)
    return {"error_x": {"type": "data", "array": list(above), "arrayminus": list(below), "symmetric": False}}


def _by_angle(one: Mapping[str, Any], unit: str) -> Document:
    def points(name: str, y: str, colour: str) -> Document:
        return {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": one["q_deg"],
            "y": one[y],
            "marker": {"color": colour, "size": 4},
        }

    joint = one["joint"]
    data = [points("residual before", "before", GREY), points("residual after", "after", BLUE)]
    if any(one["curve"]):
        data.append(points(f"what the effects named at joint {joint} move there", "curve", RED))
    title = f"Residual along what joint {joint} moves, before and after its effects are fitted"
    return {"data": data, "layout": layout(title, f"joint {joint}, deg", f"residual, {unit}")}


def _by_label(rows: Sequence[Mapping[str, Any]], what: str, unit: str) -> Document:
    names = [("" if r["joint"] is None else f"joint {r['joint']}: ") + f"{r['value']:g}" for r in rows]

    def bars(name: str, colour: str) -> Document:
        spread = {"type": "data", "array": [r[f"{name}_sd"] for r in rows]}
        return {
            "type": "bar",
            "orientation": "h",
            "name": name,
            "y": names,
            "x": [r[f"{name}_mean"] for r in rows],
            "error_x": spread,
            "marker": {"color": colour},
        }

    title = f"Residual by {what[0].lower()}{what[1:]}: mean and standard deviation"
    made = bar_layout(title, f"residual, {unit}", names, 2, barmode="group")
    made["yaxis"]["title"] = {"text": what}
    return {"data": [bars("before", GREY), bars("after", BLUE)], "layout": made}


def _contribution(rows: Sequence[Mapping[str, Any]], unit: str) -> Document:
    labels = distinct_labels([r["label"] for r in rows])

    def bars(name: str, colour: str) -> Document:
        return {
            "type": "bar",
            "orientation": "h",
            "name": name,
            "y": labels,
            "x": [r[name] for r in rows],
            "marker": {"color": colour},
        }

    made = bar_layout("How far each named effect moves the tool", f"displacement, {unit}", labels, 2, barmode="group")
    return {"data": [bars("rms", GREEN), bars("largest", GREY)], "layout": made}


def _aliases(matrix: Mapping[str, Any]) -> Document:
    labels = distinct_labels(matrix["labels"])
    trace = {
        "type": "heatmap",
        "x": labels,
        "y": labels,
        "z": matrix["values"],
        "zmin": 0,
        "zmax": 1,
        "colorscale": "Blues",
    }
    side = FRAME_PX + 120 + ROW_PX * max(8, len(labels))
    made = layout("How well signatures correlate after the geometry is fitted", "", "", width=side + 80, height=side)
    made["xaxis"] |= {"automargin": True, "tickangle": -60}
    made["yaxis"] |= {"autorange": "reversed"}
    return {"data": [trace], "layout": made}
