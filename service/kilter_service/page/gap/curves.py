"""The named effects through the residuals: points, binned means with intervals, and the fitted curve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kilter_service.contract.figures import Figure, GapFigures, Scatter
from kilter_service.page.figures.plot import BLUE, COLOURS, GREY, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.gap.bins import Bin, Point, bin_points, branches, smooth
from kilter_service.page.words import number

MOST_POINTS = 400
PREFIX = "residual_joint_"
SIDES = ("first side", "second side")


@dataclass(frozen=True)
class Curve:
    """The plot of a joint, with how many bins agree with the curve."""

    joint: int
    plot: Plot
    agree: int
    of: int
    sides: int
    named: bool


def curves(figures: GapFigures | None, unit: str) -> list[Curve]:
    """Draw a plot for each joint at which an effect was named; for all joints where none was."""
    return [_curve(joint, points, unit) for joint, points in _joints(figures) if points]


def _joints(figures: GapFigures | None) -> Iterator[tuple[int, list[Point]]]:
    extra = (figures.__pydantic_extra__ or {}) if figures is not None else {}
    for name, figure in sorted(extra.items(), key=lambda item: (len(item[0]), item[0])):
        if name.startswith(PREFIX):
            yield int(name.removeprefix(PREFIX)), list(_points(figure))


def _points(figure: Figure) -> Iterator[Point]:
    traces = [trace for trace in figure.data or [] if isinstance(trace, Scatter)]
    if len(traces) < 2:
        return
    before, after = traces[:2]
    curve = traces[2].y if len(traces) > 2 else [0.0] * len(before.y)
    named = any(curve)
    for angle, first, left, fitted in zip(before.x, before.y, after.y, curve, strict=True):
        if isinstance(angle, float | int) and first is not None and left is not None and fitted is not None:
            # Without the effect the geometry bends towards it: only beside the final geometry do both compare.
            yield Point(float(angle), left + fitted if named else first, fitted)


def _curve(joint: int, points: list[Point], unit: str) -> Curve:
    named = any(point.curve for point in points)
    sides = branches(points)
    bins = [bin_points(side) for side in sides]
    flat = [each for side in bins for each in side]
    shown = points[:: -(-len(points) // MOST_POINTS)]
    values = [p.residual for p in shown] + [p.curve for p in points] + [b.mean for b in flat]
    drawn = Plot(
        f"Residual along what joint {joint} moves", around(f"angle of joint {joint}, deg", [p.angle for p in points]),
        around(f"residual, {unit}", values), width=440.0, height=320.0, table=_table(bins, unit),
        description=_describe_bins(joint, flat, named),
    )  # fmt: skip
    drawn.points([p.angle for p in shown], [p.residual for p in shown], "one visit", colour=GREY)
    for place, (side, means) in enumerate(zip(sides, bins, strict=True)):
        _side(drawn, side, means, place, len(sides), named)
    return Curve(joint, drawn, sum(b.agrees for b in flat), len(flat), len(sides), named)


def _side(drawn: Plot, side: list[Point], means: list[Bin], place: int, of: int, named: bool) -> None:
    tail = f", {SIDES[place]}" if of > 1 else ""
    colour = COLOURS[1 + place]
    if named:
        one_line = of == 1 and smooth(side)
        line: Sequence[Point | Bin] = side if one_line else means
        label = "fitted curve" if one_line else "fitted effect, mean of each bin"
        drawn.line([p.angle for p in line], [p.curve for p in line], label + tail, place, BLUE)
    for each in means:
        drawn.line([each.angle] * 2, [each.mean - each.half, each.mean + each.half], colour=colour)
    drawn.points(
        [b.angle for b in means], [b.mean for b in means], f"mean of a bin, 95 % interval{tail}", 1 + place, colour,
        [f"{number(b.mean)} ± {number(b.half, 2)}, curve {number(b.curve)}, {b.count} visits" for b in means],
    )  # fmt: skip


def _describe_bins(joint: int, bins: list[Bin], named: bool) -> str:
    if not named:
        return f"Residuals over the angle of joint {joint}; no effect was named there."
    agree = sum(each.agrees for each in bins)
    return f"The fitted effect lies within the 95 % interval of the mean in {agree} of {len(bins)} bins."


def _table(bins: list[list[Bin]], unit: str) -> tuple[list[str], list[list[str]]]:
    head = ["Angles, deg", "Visits", f"Mean residual, {unit}", f"95 % interval, ± {unit}", f"Fitted effect, {unit}"]
    rows = []
    for place, side in enumerate(bins):
        tail = f" ({SIDES[place]})" if len(bins) > 1 else ""
        rows += [
            [f"{b.low:.1f} to {b.high:.1f}{tail}", str(b.count), number(b.mean), number(b.half, 2), number(b.curve)]
            for b in side
        ]
    return head, rows
