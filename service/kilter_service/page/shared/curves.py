"""Named effects as curves: over the quantity that each follows, and through the residuals of a joint."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from kilter_service.contract.figures import CurveSide, CurveVisits, EffectCurve, Figure, GapFigures, Scatter
from kilter_service.jobs.budgets import SIDES, across, model, quantity, title, unit_of_x, upwards, visit
from kilter_service.page.figures.plot import BLUE, COLOURS, GREY, RED, SKY, THIN, Plot, around
from kilter_service.page.shared.naming import format_effect_at_joints, format_effect_name
from kilter_service.page.words import number

WIDTH, HEIGHT = 440.0, 340.0  # what is written can be read where the window is narrow, too
COLOUR_OF = {1.0: BLUE, -1.0: SKY}
PLACE_OF = {1.0: 0, -1.0: 1, 0.0: 2}  # marks and dashes
RIVAL = 3  # its dashes
MARKED = 0.94  # of the way along x, where the distance of two sides is marked


@dataclass(frozen=True)
class OwnCurve:
    """The plot of an effect at a joint, with what is said below it."""

    title: str
    plot: Plot
    said: tuple[str, ...]


def own_curves(curves: Sequence[EffectCurve] | None) -> list[OwnCurve]:
    """Draw every curve of a result; none of an earlier one."""
    return [
        OwnCurve(format_effect_at_joints(curve.id, [curve.joint]), plot(curve), tuple(_describe_curve(curve)))
        for curve in curves or []
    ]


def plot(curve: EffectCurve, width: float = WIDTH, height: float = HEIGHT) -> Plot:
    """Draw an effect over what it follows."""
    drawn = Plot(
        title(curve),
        around(across(curve), ([x for side in curve.sides for x in side.x] + curve.visits.x)),
        around(upwards(curve), _values(curve)),
        width=width,
        height=height,
        table=_table(curve),
        description=" ".join(_describe_curve(curve)),
    )
    for side in curve.sides:
        if side.low is not None and side.high is not None:
            drawn.band(side.x, side.low, side.high, "", 0 if side.direction != -1.0 else 1)
    directions = curve.visits.direction
    for direction in [None] if directions is None else sorted(set(directions), reverse=True):
        _dots(drawn, curve, direction)
    if curve.rival is not None:
        for place, side in enumerate(curve.rival.sides):
            label = "" if place else f"refused: {format_effect_name(curve.rival)}"
            drawn.line(side.x, side.y, label, RIVAL, RED, THIN)
    for side in curve.sides:
        _model(drawn, side)
    if curve.distance is not None and len(curve.sides) == 2:
        _mark_distance(drawn, curve)
    return drawn


def _model(drawn: Plot, side: CurveSide) -> None:
    place = PLACE_OF[side.direction or 1.0]
    drawn.line(side.x, side.y, model(side.direction), place, COLOUR_OF[side.direction or 1.0])


def _dots(drawn: Plot, curve: EffectCurve, direction: float | None) -> None:
    visits = curve.visits
    own = [k for k in range(len(visits.x)) if _direction(visits, k) == direction]
    colour = GREY if direction is None else COLOUR_OF.get(direction, GREY)
    for k in own:
        drawn.line([visits.x[k]] * 2, [visits.y[k] - visits.half[k], visits.y[k] + visits.half[k]], "", 0, colour, THIN)
    says = [f"{number(visits.y[k])} ± {number(visits.half[k], 2)}, model {number(visits.curve[k])}" for k in own]
    drawn.points(
        [visits.x[k] for k in own],
        [visits.y[k] for k in own],
        visit(direction),
        PLACE_OF[direction or 0.0] if direction is not None else 0,
        colour,
        says,
    )


def _mark_distance(drawn: Plot, curve: EffectCurve) -> None:
    place = round(MARKED * (len(curve.sides[0].x) - 1))
    first, second = (side.y[place] for side in curve.sides)
    drawn.distance(curve.sides[0].x[place], min(first, second), max(first, second), _format_side_distance(curve)[0])


def _format_side_distance(curve: EffectCurve) -> tuple[str, str]:
    """How far two sides are apart, and its interval; none of a curve with one."""
    apart = curve.distance
    if apart is None:
        return "", ""
    sign = -1.0 if apart.value < 0 else 1.0
    low, high = sorted((sign * apart.low, sign * apart.high))
    return f"{number(abs(apart.value))} {curve.unit}", f"{number(low)} to {number(high)}"


def _direction(visits: CurveVisits, place: int) -> float | None:
    return None if visits.direction is None else visits.direction[place]


def _values(curve: EffectCurve) -> list[float]:
    visits = curve.visits
    ends = [y + s * half for y, half in zip(visits.y, visits.half, strict=True) for s in (-1.0, 1.0)]
    others = curve.rival.sides if curve.rival is not None else []
    return [y for side in (*curve.sides, *others) for y in side.y] + ends


def _describe_curve(curve: EffectCurve) -> Iterator[str]:
    visits = curve.visits
    inside = sum(abs(y - c) <= h for y, c, h in zip(visits.y, visits.curve, visits.half, strict=True))
    yield f"The model lies within the 95 % interval of {inside} of {len(visits.x)} visits."
    if visits.faint:
        yield (
            f"{visits.faint} of {visits.of} visits are not drawn: the tool was so near the axis of the joint that they say "
            "little of it."
        )
    if curve.distance is not None:
        distance, interval = _format_side_distance(curve)
        less = "less" if curve.distance.value < 0 else "more"
        yield f"After a motion in direction + joint {curve.joint} stands {distance} ({interval}) {less} than after one in −."
    if curve.rival is not None:
        yield (
            f"The thin line is the best that {format_effect_name(curve.rival)} makes of these visits, with a zero of "
            "its own: it leaves "
            f"{number(curve.rival.times)} times the squares that the model leaves."
        )


def _table(curve: EffectCurve) -> tuple[list[str], list[list[str]]]:
    visits, unit = curve.visits, curve.unit
    head = [
        f"{quantity(curve)}, {unit_of_x(curve)}",
        f"A visit, {unit}",
        f"95 % interval, ± {unit}",
        f"Model, {unit}",
    ]
    head[0] = head[0][0].upper() + head[0][1:]
    rows = []
    for k in sorted(range(len(visits.x)), key=lambda k: visits.x[k]):
        direction = _direction(visits, k)
        tail = "" if direction is None else f" ({SIDES[direction]})"
        cells = [number(visits.y[k]), number(visits.half[k], 2), number(visits.curve[k])]
        rows.append([f"{number(visits.x[k], 4)}{tail}", *cells])
    return head, rows


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
BRANCHES = ("first side", "second side")


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
        table=_bins_table(bins, unit),
        description=_describe_bins(joint, flat, named),
    )
    drawn.points([p.angle for p in shown], [p.residual for p in shown], "one visit", colour=GREY)
    for place, (side, means) in enumerate(zip(sides, bins, strict=True)):
        _side(drawn, side, means, place, len(sides), named)
    return Curve(joint, drawn, sum(b.agrees for b in flat), len(flat), len(sides), named)


def _side(drawn: Plot, side: list[Point], means: list[Bin], place: int, of: int, named: bool) -> None:
    tail = f", {BRANCHES[place]}" if of > 1 else ""
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


def _bins_table(bins: list[list[Bin]], unit: str) -> tuple[list[str], list[list[str]]]:
    head = ["Angles, deg", "Visits", f"Mean residual, {unit}", f"95 % interval, ± {unit}", f"Fitted effect, {unit}"]
    rows = []
    for place, side in enumerate(bins):
        tail = f" ({BRANCHES[place]})" if len(bins) > 1 else ""
        rows += [
            [f"{b.low:.1f} to {b.high:.1f}{tail}", str(b.count), number(b.mean), number(b.half, 2), number(b.curve)]
            for b in side
        ]
    return head, rows
