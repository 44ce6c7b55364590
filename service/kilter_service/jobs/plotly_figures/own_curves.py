"""Each named effect over the quantity that it follows, as Plotly documents: what the page draws of the same curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from kilter_service.contract.effect_curves import CurveSide, EffectCurve
from kilter_service.jobs import curve_words
from kilter_service.jobs.plotly_figures.layout import BLUE, GREY, ORANGE, RED, Document, layout, three_digits

COLOUR_OF: dict[float | None, str] = {1.0: BLUE, -1.0: ORANGE, 0.0: GREY, None: BLUE}
THIN, BOLD, DOT_PX = 1.0, 2.5, 5


def own_curves(curves: Sequence[dict[str, Any]]) -> dict[str, Document]:
    """Draw every curve of a report, ``effect_curve_backlash_joint_2`` and so on."""
    out: dict[str, Document] = {}
    for one in curves:
        curve = EffectCurve.model_validate(one)
        name = f"effect_curve_{curve.id}_joint_{curve.joint}"
        taken = sum(other == name or other.startswith(f"{name}_again") for other in out)
        title = curve_words.title(curve) + _format_direction_gap(curve)
        made = layout(title, curve_words.across(curve), curve_words.upwards(curve))
        out[name if not taken else f"{name}_again_{taken}"] = {"data": list(_traces(curve)), "layout": made}
    return out


def _traces(curve: EffectCurve) -> Iterator[Document]:
    for side in curve.sides:
        if side.low is not None and side.high is not None:
            yield _band(side, side.low, side.high)
    yield from _visits(curve)
    for place, side in enumerate(curve.rival.sides if curve.rival is not None else []):
        assert curve.rival is not None
        yield _line(
            side.x, side.y, f"refused: {curve_words.format_effect_name(curve.rival)}", RED, THIN, named=not place
        )
    for side in curve.sides:
        yield _line(side.x, side.y, curve_words.model(side.direction), COLOUR_OF[side.direction], BOLD)


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
            "type": "scatter", "mode": "markers", "name": curve_words.visit(direction), "showlegend": True,
            "x": [visits.x[k] for k in own], "y": [visits.y[k] for k in own],
            "marker": {"color": colour, "size": DOT_PX},
        }  # fmt: skip


def _band(side: CurveSide, low: Sequence[float], high: Sequence[float]) -> Document:
    """The area between both ends of the band, as one closed line."""
    x, y = [*side.x, *reversed(side.x)], [*high, *reversed(low)]
    return {**_line(x, y, "95 % band", COLOUR_OF[side.direction], 0.0, named=False), "fill": "toself"}


def _line(
    x: Sequence[float | None], y: Sequence[float | None], name: str, colour: str, width: float, *, named: bool = True
) -> Document:
    return {
        "type": "scatter", "mode": "lines", "name": name, "showlegend": named, "x": list(x), "y": list(y),
        "line": {"color": colour, "width": width},
    }  # fmt: skip


def _format_direction_gap(curve: EffectCurve) -> str:
    """How far both directions are apart, below the title; nothing where there is one."""
    apart = curve.distance
    if apart is None:
        return ""
    sign = -1.0 if apart.value < 0 else 1.0
    low, high = sorted((sign * apart.low, sign * apart.high))
    said = f"{three_digits(abs(apart.value))} {curve.unit} ({three_digits(low)} to {three_digits(high)})"
    return f"<br><sup>both directions are {said} apart</sup>"
