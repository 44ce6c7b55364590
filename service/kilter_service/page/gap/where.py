"""Where the model was wrong: factors by joint as a heat map, every level in a table."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from kilter_service.contract.gap_details import Place
from kilter_service.page.figures.heat_map import HeatMap
from kilter_service.page.shared.called import chance
from kilter_service.page.words import number

SURE = 0.05
OF_JOINT = re.compile(r"^(?:contrast: )?(.*) of joint (\d+)$")
WHOLE = "whole arm"
CELL = 44.0
Cells = dict[tuple[str, str], float]


def heat_map(places: Sequence[Place]) -> HeatMap | None:
    """Draw the levels that stand out, the largest of each factor; None where nothing does."""
    cells: Cells = {}
    for place in places:
        if stands_out(place):
            cell = _cell(place.factor or "")
            cells[cell] = max(cells.get(cell, 0.0), times(place))
    if not cells:
        return None
    rows = list(dict.fromkeys(row for row, _ in cells))
    joints = sorted({column for _, column in cells} - {WHOLE}, key=lambda name: int(name.split()[-1]))
    columns = [*joints, *([WHOLE] if any(column == WHOLE for _, column in cells) else [])]
    values = [[cells.get((row, column), math.nan) for column in columns] for row in rows]
    return HeatMap(
        "Where the model was wrong", rows, columns, values, low=1.0, high=max(2.0, *cells.values()), cell=CELL,
        description=_describe_largest(cells),
    )  # fmt: skip


def stands_out(place: Place) -> bool:
    """Whether noise seldom gives such an excess anywhere."""
    return place.p_value is not None and place.p_value < SURE and (place.excess or 0.0) > 0.0


def times(place: Place) -> float:
    """Return the error there in multiples of what noise leaves."""
    return math.sqrt(max(0.0, 1.0 + (place.excess or 0.0)))


def table(places: Sequence[Place]) -> tuple[list[str], list[list[str]]]:
    """Return every level of the report."""
    rows = [
        [f"{_words(p.factor or '')}: {p.level or ''}", number(times(p), 2), chance(p.p_value), str(p.visits or "–")]
        for p in places
    ]
    return ["Factor and level", "Times what noise leaves", "Chance by noise (p)", "Visits"], rows


def clearest(places: Sequence[Place]) -> str:
    """Say the place that is the least likely by noise, in words."""
    found = [place for place in places if stands_out(place)]
    if not found:
        return ""
    best = min(found, key=lambda place: (place.p_value or 0.0, -(place.excess or 0.0)))
    # A contrast of one pose under two conditions often holds several joints at once: bins tell which one.
    bins = [place for place in found if not (place.factor or "").startswith("contrast")]
    worst = max(bins, key=lambda place: place.excess or 0.0) if bins else best
    return f"{_words(worst.factor or '')}: {worst.level} ({number(times(worst), 2)} times what noise leaves)"


def _cell(factor: str) -> tuple[str, str]:
    found = OF_JOINT.match(factor)
    contrast = factor.startswith("contrast: ")
    name = found[1] if found else factor.removeprefix("contrast: ")
    return (f"same pose, two {name}s" if contrast else name), (f"joint {found[2]}" if found else WHOLE)


def _words(factor: str) -> str:
    if factor.startswith("contrast: "):
        return f"same pose under two values, {factor.removeprefix('contrast: ')}"
    return factor


def _describe_largest(cells: Cells) -> str:
    row, column = max(cells, key=lambda cell: cells[cell])
    return f"The largest: {row}, {column}, {number(cells[row, column], 2)} times what noise leaves."
