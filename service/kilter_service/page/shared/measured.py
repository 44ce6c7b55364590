"""What views say of measured rows: the numbers in words, coverage, places, and rows that look wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from kilter_service.campaigns.facts import ColumnFacts
from kilter_service.ground.wire import to_mm
from kilter_service.page import words
from kilter_service.page.figures.plot import (
    BLUE,
    ERROR,
    LETTER,
    Group,
    Plot,
    places_from_two_sides,
    room_for,
    whole_svg,
)

if TYPE_CHECKING:
    from kilter_service.campaigns.facts import Facts, JointFacts

HEIGHT, BAR = 42.0, 16.0
WIDTH, RIGHT = 440.0, 8.0


@dataclass(frozen=True)
class Bar:
    """A joint: its bar from ``low`` to ``high``, counts of rows along it, the span of the readings, and what is said."""

    name: str
    low: float
    high: float
    counts: Sequence[int]
    first: float
    last: float
    said: str


@dataclass(frozen=True)
class Coverage:
    """The bars of all joints."""

    title: str
    bars: Sequence[Bar]
    table: tuple[Sequence[str], Sequence[Sequence[str]]]

    def svg(self) -> Markup:
        """Return it as SVG."""
        width = room_for(WIDTH)
        left = 12 + LETTER * max((len(bar.name) for bar in self.bars), default=0)
        height = HEIGHT * len(self.bars) + 4
        said = "; ".join(f"{bar.name}: {bar.said}" for bar in self.bars)
        parts = [self._drawn(bar, left, HEIGHT * k, width - RIGHT - left) for k, bar in enumerate(self.bars)]
        return whole_svg(width, height, parts, self.title, said)

    def _drawn(self, bar: Bar, left: float, top: float, room: float) -> str:
        most = max(bar.counts, default=0) or 1
        step = room / max(len(bar.counts), 1)
        y = top + 18

        def place(value: float) -> float:
            return left + room * (value - bar.low) / (bar.high - bar.low)

        parts = [
            f'<text x="{left - 6:.1f}" y="{y + 12:.1f}" text-anchor="end">{escape(bar.name)}</text>',
            f'<text x="{left:.1f}" y="{y - 5:.1f}" font-size="11">{escape(bar.said)}</text>',
            f'<rect x="{left:.1f}" y="{y:.1f}" width="{room:.1f}" height="{BAR}" fill="none" stroke="currentColor" '
            'stroke-opacity="0.5"/>',
        ]
        for k, count in enumerate(bar.counts):
            if count:
                shade = 0.25 + 0.75 * count / most
                parts.append(
                    f'<rect x="{left + k * step:.1f}" y="{y:.1f}" width="{step:.1f}" height="{BAR}" fill="{BLUE}" '
                    f'fill-opacity="{shade:.2f}"><title>{count} rows</title></rect>'
                )
        for value in (bar.first, bar.last):
            x = place(value)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 2:.1f}" y2="{y + BAR + 2:.1f}" stroke="currentColor" '
                'stroke-width="2"/>'
            )
        return "".join(parts)


LITTLE = 0.3  # of a joint's range: little was measured of it


def describe_facts(facts: Facts, lines: Sequence[int] = (), campaign: str = "") -> dict[str, Any]:
    """Put facts in words and figures.

    ``lines``: the line of the file behind each row, where it is known; ``campaign`` is the id of the one that has these rows.
    """
    noise, why = _noise(facts)
    little = [one for one in facts.joints if one.share is not None and one.share < LITTLE]
    places = {row: f"{row} (line {line} of the file)" for row, line in enumerate(lines, 1)}
    return {
        "facts": facts,
        "headline": _headline(facts),
        "noise": noise,
        "noise_why": why,
        "columns": [_column(one) for one in facts.columns],
        "coverage": _coverage(facts.joints),
        "places": _places(facts, campaign),
        "little": [f"{joint.name} ({words.percent(joint.share)})" for joint in little],
        "doubts": [(places.get(one.row, str(one.row)), one.why) for one in facts.doubtful.rows],
    }


def _headline(facts: Facts) -> str:
    found = facts.repeats
    visits = "" if found.visits == found.poses else f", {words.count(found.visits)} visits"
    return f"{words.count(facts.rows)} rows at {words.count(found.poses)} poses{visits}"


def _noise(facts: Facts) -> tuple[str, str]:
    """The noise that repeats show, and what it rests on."""
    found = facts.repeats
    if facts.mixed_up:
        return words.NONE, "not told by rows that are mixed up"
    if found.between is not None:
        why = f"from {words.count(found.repeated)} poses that were visited again"
        shots = "" if found.within is None else f"; {words.mm(to_mm(found.within))} between rows of one visit"
        return words.mm(to_mm(found.between)), why + shots
    if found.within is not None:
        why = (
            "between rows of one visit only: it leaves out what differs when the arm comes back. Visit some poses again"
        )
        return words.mm(to_mm(found.within)), why
    return words.NONE, "no pose was measured twice, so the rows do not say it. Visit some poses again"


def _column(one: ColumnFacts) -> Sequence[str]:
    gaps = "none" if one.empty == 0 else words.count(one.empty)
    return [one.name, one.what, one.unit or "–", words.number(one.low, 5), words.number(one.high, 5), gaps]


def _coverage(joints: Sequence[JointFacts]) -> Coverage:
    bars, rows = [], []
    for joint in joints:
        low, high = words.number(joint.low, 4), words.number(joint.high, 4)
        ends = [words.NONE if end is None else words.number(end, 4) for end in joint.limits]
        share = "open limits" if joint.share is None else f"{100 * joint.share:.0f} % of the range"
        said = f"{low} to {high} {joint.unit} (limits {ends[0]} to {ends[1]}): {share}"
        bars.append(Bar(joint.name, joint.bin_low, joint.bin_high, joint.bins, joint.low, joint.high, said))
        rows.append(
            [joint.name, low, high, *ends, joint.unit, "–" if joint.share is None else words.percent(joint.share)]
        )
    head = ["Joint", "Lowest", "Highest", "Lower limit", "Upper limit", "Unit", "Share of the range"]
    return Coverage("Readings of each joint within its limits", bars, (head, rows))


def _places(facts: Facts, campaign: str) -> list[Plot]:
    """Where the tool was seen, from above and from the side; rows that look wrong stand out."""
    if not facts.places:
        return []
    odd, groups = {one.row for one in facts.doubtful.rows}, list[Group]()
    for wrong, label, number, colour, tail in (
        (False, "measured", 0, BLUE, ""),
        (True, "looks wrong", 2, ERROR, ", looks wrong"),
    ):
        which = [k for k, (row, _) in enumerate(facts.places) if (row in odd) == wrong]
        rows = [facts.places[k][0] for k in which]
        identities = [f"{campaign}/{row}" for row in rows] if campaign else []  # nothing of rows that are not stored
        groups.append((label, number, colour, which, [f"row {row}{tail}" for row in rows], identities))
    numbers = [[f"row {row}", *(words.number(value, 6) for value in place)] for row, place in facts.places[:100]]
    table = (["Row", "x, mm", "y, mm", "z, mm"], numbers)
    return places_from_two_sides([place for _, place in facts.places], groups, ": places that were measured, mm", table)
