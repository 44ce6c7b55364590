"""Named effects over the quantities that they follow: model with its band, visits with their bars, and what was refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kilter_service.contract.effect_curves import CurveSide, CurveVisits, EffectCurve
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.jobs.curve_words import SIDES, across, model, quantity, title, unit_of_x, upwards, visit
from kilter_service.page.figures.plot import BLUE, GREY, RED, SKY, THIN, Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.shared.called import format_effect_at_joints, format_effect_name
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
    return [OwnCurve(_curve_effect_name(curve), plot(curve), tuple(_describe_curve(curve))) for curve in curves or []]


def has_effect_without_curve(result: GapResult) -> bool:
    """Whether an effect was named that no curve shows, as it does more than move joints."""
    shown = {(curve.id, tuple(curve.joints or ())) for curve in result.effect_curves or []}
    return any((effect.id, tuple(effect.joints or ())) not in shown for effect in result.effects or [])


def _curve_effect_name(curve: EffectCurve) -> str:
    return format_effect_at_joints(curve.id, [curve.joint])


def plot(curve: EffectCurve, width: float = WIDTH, height: float = HEIGHT) -> Plot:
    """Draw an effect over what it follows."""
    drawn = Plot(
        title(curve),
        around(across(curve), _places(curve)),
        around(upwards(curve), _values(curve)),
        width=width,
        height=height,
        table=_table(curve),
        description=" ".join(_describe_curve(curve)),
    )
    for side in curve.sides:
        if side.low is not None and side.high is not None:
            drawn.band(side.x, side.low, side.high, "", 0 if side.direction != -1.0 else 1)
    for direction in _directions(curve.visits):
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


def _directions(visits: CurveVisits) -> list[float | None]:
    if visits.direction is None:
        return [None]
    return [*sorted(set(visits.direction), reverse=True)]


def _direction(visits: CurveVisits, place: int) -> float | None:
    return None if visits.direction is None else visits.direction[place]


def _places(curve: EffectCurve) -> list[float]:
    return [x for side in curve.sides for x in side.x] + curve.visits.x


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
