"""The named effects through the residuals: points, binned means with intervals, and the fitted curve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from kilter_service.contract.figures import Figure, GapFigures, Scatter
from kilter_service.page.figures.plot import BLUE, COLOURS, GREY, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.words import number

POINTS_PER_BIN, MOST = 6, 12  # points in a bin, and bins
TWO_SIDES = 0.4  # share of the ups and downs that must vanish when the two sides of a curve are parted
SMOOTH = 0.15  # ups and downs for each point, in ranges of the curve, below which it is a line over the angle
NORMAL = 1.959964


@dataclass(frozen=True)
class Point:
    """A visit: the angle, the residual there when the effect is taken out of the final model, and the fitted curve."""

    angle: float
    residual: float
    curve: float


@dataclass(frozen=True)
class Bin:
    """Mean residual of the points of a bin, half the width of its 95 % interval, and the mean of the curve there."""

    low: float
    high: float
    count: int
    angle: float
    mean: float
    half: float
    curve: float

    @property
    def agrees(self) -> bool:
        """Whether the curve lies within the interval."""
        return abs(self.curve - self.mean) <= self.half


def branches(points: Sequence[Point]) -> list[list[Point]]:
    """Part the points of an effect with two sides, such as a backlash: one angle has two values of its curve."""
    ordered = sorted(points, key=lambda point: point.angle)
    if not ordered:
        return []
    middle = (max(p.curve for p in ordered) + min(p.curve for p in ordered)) / 2
    sides = [[p for p in ordered if p.curve > middle], [p for p in ordered if p.curve <= middle]]
    if all(sides) and sum(map(_travel, sides)) < TWO_SIDES * _travel(ordered):
        return sides
    return [ordered]


def smooth(points: Sequence[Point]) -> bool:
    """Whether the curve is one line over the angle, which nothing else moves up and down."""
    height = max(p.curve for p in points) - min(p.curve for p in points)
    return _travel(points) <= max(6.0, SMOOTH * len(points)) * height


def _travel(points: Sequence[Point]) -> float:
    return sum(abs(b.curve - a.curve) for a, b in pairwise(points))


def bin_points(points: Sequence[Point]) -> list[Bin]:
    """Put points, ordered by angle, into bins of about as many each."""
    number = max(1, min(MOST, len(points) // POINTS_PER_BIN))
    edges = [round(k * len(points) / number) for k in range(number + 1)]
    return [_bin(points[a:b]) for a, b in pairwise(edges) if b - a > 1]


def _bin(points: Sequence[Point]) -> Bin:
    count = len(points)
    mean = math.fsum(p.residual for p in points) / count
    # The curve may rise within the bin: what scatters is the residual about it.
    rest = [p.residual - p.curve for p in points]
    middle = math.fsum(rest) / count
    spread = math.sqrt(math.fsum((r - middle) ** 2 for r in rest) / (count - 1))
    return Bin(
        points[0].angle,
        points[-1].angle,
        count,
        math.fsum(p.angle for p in points) / count,
        mean,
        student(count - 1) * spread / math.sqrt(count),
        math.fsum(p.curve for p in points) / count,
    )


def student(freedom: int) -> float:
    """Return the 97.5 % point of Student's distribution (Cornish and Fisher's expansion), within 1 % from 3 on."""
    z = NORMAL
    return (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    )


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


def curves(figures: GapFigures | None, unit: str, width: float = 440.0, height: float = 320.0) -> list[Curve]:
    """Draw a plot for each joint at which an effect was named; for all joints where none was."""
    return [_curve(joint, points, unit, width, height) for joint, points in _joints(figures) if points]


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


def _curve(joint: int, points: list[Point], unit: str, width: float, height: float) -> Curve:
    named = any(point.curve for point in points)
    sides = branches(points)
    bins = [bin_points(side) for side in sides]
    flat = [each for side in bins for each in side]
    shown = points[:: -(-len(points) // MOST_POINTS)]
    values = [p.residual for p in shown] + [p.curve for p in points] + [b.mean for b in flat]
    drawn = Plot(
        f"Residual along what joint {joint} moves",
        around(f"angle of joint {joint}, deg", [p.angle for p in points]),
        around(f"residual, {unit}", values),
        width=width,
        height=height,
        table=_table(bins, unit),
        description=_describe_bins(joint, flat, named),
    )
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
        label = "fitted curve" if one_line else "fitted effect"
        drawn.line([p.angle for p in line], [p.curve for p in line], label + tail, place, BLUE)
    for each in means:
        drawn.line([each.angle] * 2, [each.mean - each.half, each.mean + each.half], colour=colour)
    drawn.points(
        [b.angle for b in means],
        [b.mean for b in means],
        "" if place else "mean, 95 % interval",
        1 + place,
        colour,
        [f"{number(b.mean)} ± {number(b.half, 2)}, curve {number(b.curve)}, {b.count} visits" for b in means],
    )


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
