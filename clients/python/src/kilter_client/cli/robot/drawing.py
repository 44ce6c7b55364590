"""A checked robot as text: the arm at zero from the side and from above, its axes and what looks wrong."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from kilter_client.cli.terminal.output import print_line
from kilter_client.cli.terminal.tables import show_rows

Document = dict[str, Any]
Points = Sequence[tuple[float, float]]

WIDTH, HEIGHT = 60, 20
ASPECT = 2.0  # a character is twice as high as wide
VIEWS = (("from the side: x to the right, z up", 0, 2), ("from above: x to the right, y up", 0, 1))


def show_check(document: Document) -> None:
    """Print the check of a robot."""
    print_line(f"{document['name']} at zero, o base, 1 2 3 ... axes, * flange, T tool")
    for title, across, up in VIEWS:
        print_line(f"\n{title}")
        print_line(drawing([(p[across], p[up]) for p in document["zero"]["points_mm"]]))
    tool = document["zero"]["tool"]
    print_line(f"\ntool at zero: {', '.join(f'{name} {value:g}' for name, value in tool.items())}")
    print_line(f"reach of the tool from the first axis: {document['reach_mm']:.0f} mm\n")
    columns = ("", "joint", "kind", "axis", "through mm", "to the one before", "limits")
    show_rows(columns, [_axis(k, axis, document["joints"]) for k, axis in enumerate(document["axes"], 1)])
    for word in document.get("drives") or ():
        print_line(f"drive: {word}")
    for word in document["suspicious"] or ("nothing",):
        print_line(f"suspicious: {word}")
    for word in document["notes"]:
        print_line(f"note: {word}")


def _axis(number: int, axis: Document, joints: Sequence[Document]) -> tuple[str, ...]:
    joint = next(j for j in joints if j["name"] == axis["joint"])
    unit = "deg" if joint.get("limits_deg") else "mm"
    low, high = joint.get(f"limits_{unit}") or (None, None)
    limits = "none" if low is None or high is None else f"{low:g} to {high:g} {unit}"
    angle = axis["angle_to_previous_deg"]
    return (
        str(number),
        _driven(axis),
        axis["kind"],
        " ".join(f"{v:.3g}" for v in axis["direction"]),
        " ".join(f"{v:.1f}" for v in axis["point_mm"]),
        "" if angle is None else f"{angle:g} deg, {axis['distance_to_previous_mm']:.1f} mm",
        limits,
    )


def _driven(axis: Document) -> str:
    """What moves an axis: its joint, with the ratio and the drive where it follows one."""
    moved = axis["joint"] if axis["ratio"] == 1 else f"{axis['joint']} x {axis['ratio']:g}"
    return f"{moved} ({axis['drive']})" if axis.get("drive") else moved


def drawing(points: Points) -> str:
    """Draw the polyline through the points: base, axes, flange, tool."""
    canvas = [[" "] * WIDTH for _ in range(HEIGHT)]
    cells = _cells(points)
    for (x0, y0), (x1, y1) in itertools.pairwise(cells):
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for k in range(steps + 1):
            canvas[round(y0 + (y1 - y0) * k / steps)][round(x0 + (x1 - x0) * k / steps)] = "."
    # The base and the tool are drawn last: where marks fall together they matter most.
    marks = ["o", *(str(k % 10) for k in range(1, len(cells) - 2)), "*", "T"]
    for (x, y), mark in [*zip(cells[1:], marks[1:], strict=True), (cells[0], "o")]:
        canvas[y][x] = mark
    return "\n".join("".join(row).rstrip() for row in reversed(canvas)).strip("\n")


def _cells(points: Points) -> list[tuple[int, int]]:
    """Columns and rows of the points, the same scale both ways."""
    low_x, low_y = (min(p[k] for p in points) for k in (0, 1))
    span_x, span_y = (max(p[k] for p in points) - low for k, low in ((0, low_x), (1, low_y)))
    scale = min((WIDTH - 1) / max(span_x, 1e-9), ASPECT * (HEIGHT - 1) / max(span_y, 1e-9))
    return [(round((x - low_x) * scale), round((y - low_y) * scale / ASPECT)) for x, y in points]
