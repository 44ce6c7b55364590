"""A plot with two axes: lines, points, bars and bands."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from itertools import pairwise

from markupsafe import Markup, escape

from kilter_service.contract.wording import unit_of_length

COOKIE = "kilter-width"  # of the browser's window, pixels: the page's scripts say it
MARGINS = 52.0  # pixels beside a figure in a narrow window: of the page and of the card
NARROWEST, WIDEST = 260.0, 10_000.0

_ROOM: ContextVar[float] = ContextVar("room", default=WIDEST)


def heard(told: str | None) -> None:
    """Take the width of the window; what is not a width, or is missing, leaves all figures as wide as they are."""
    width = int(told) if told is not None and told.isascii() and told.isdigit() and len(told) < 6 else 0
    _ROOM.set(min(max(width - MARGINS, NARROWEST), WIDEST) if width else WIDEST)


def room_for(width: float) -> float:
    """Return how wide a figure becomes that is so wide where there is room."""
    return min(width, _ROOM.get())


TICKS = 6  # about so many along an axis
DATES = 5  # dates that have room along an axis
DAYS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
EPOCH = date(1970, 1, 1)
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True)
class Axis:
    """What an axis shows: its label with the unit, and from where to where; ``names`` instead where it has no numbers."""

    label: str
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    names: tuple[str, ...] = ()
    times: float = 1.0  # what is written along it for each of what is drawn: 1000 where mm are written as µm

    def share(self, value: float) -> float:
        """Return how far along the axis a value is, 0 to 1 (outside where it is outside)."""
        if self.log:
            return (math.log10(max(value, 1e-300)) - math.log10(self.low)) / (
                math.log10(self.high) - math.log10(self.low)
            )
        return (value - self.low) / (self.high - self.low)

    def ticks(self) -> list[tuple[float, str]]:
        """Return the numbers or names along the axis, each with its place."""
        if self.names:
            return [(place + 0.5, name) for place, name in enumerate(self.names)]
        low, high = self.times * self.low, self.times * self.high
        written = _decades(low, high) if self.log else _round_numbers(low, high)
        return [(place / self.times, text) for place, text in written]


@dataclass(frozen=True)
class Days(Axis):
    """An axis of days, counted from 1970; what is written along it are dates."""

    def ticks(self) -> list[tuple[float, str]]:
        """Return whole days along the axis, each with its place."""
        step = next((days for days in DAYS if (self.high - self.low) / days <= DATES), math.ceil(self.high - self.low))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [(float(one * step), f"{EPOCH + timedelta(days=one * step):%Y-%m-%d}") for one in range(first, last + 1)]


def days_around(label: str, days: Sequence[float]) -> Days:
    """Return an axis that shows all these days, with a little room."""
    low, high = min(days, default=0.0), max(days, default=0.0)
    room = max(0.04 * (high - low), 0.5)
    return Days(label, low - room, high + room)


def category_axis(label: str, names: Sequence[str]) -> Axis:
    """Return an axis of names, each one wide, from 0."""
    return Axis(label, 0.0, float(max(len(names), 1)), names=tuple(names))


def around(label: str, values: Sequence[float], zero: bool = False, log: bool = False) -> Axis:
    """Return an axis that shows all finite values, with a little room; ``zero``: and zero too."""
    shown = [value for value in values if math.isfinite(value) and (value > 0 or not log)] or [1.0 if log else 0.0]
    low, high = min(shown), max(shown)
    if log:
        low, high = 10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high))
        return Axis(label, low, high if high > low else 10 * low, log=True)
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
        high = high if high > low else 1.0  # nothing but zeros
    room = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
    return Axis(label, low if zero and low == 0 else low - room, high if zero and high == 0 else high + room)


def lengths(what: str, values: Sequence[float], zero: bool = False, log: bool = False) -> Axis:
    """Return an axis of lengths in mm, along which stands the unit of the largest, as in the table below."""
    unit, times = unit_of_length(max((abs(value) for value in values if math.isfinite(value)), default=1.0))
    return replace(around(f"{what}, {unit}", values, zero, log), times=times)


def written(value: float, step: float) -> str:
    """Write a number of an axis: no digits finer than the step."""
    if value == 0:
        return "0"
    if abs(value) >= 1e6 or step < 1e-6:
        return f"{value:.3g}"
    return f"{value:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}" if step % 1 else f"{value:.0f}"


def _round_numbers(low: float, high: float) -> list[tuple[float, str]]:
    raw = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * part for part in STEPS if power * part >= raw * (1 - 1e-9))
    shown = step / 10 if step / power == 2.5 else step  # 2.5 has a digit more than its power of ten
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [(number * step, written(number * step, shown)) for number in range(first, last + 1)]


def _decades(low: float, high: float) -> list[tuple[float, str]]:
    first, last = round(math.log10(low)), round(math.log10(high))
    stride = max(1, (last - first) // TICKS)
    return [(10.0**power, f"{10.0**power:g}") for power in range(first, last + 1, stride)]


# Okabe and Ito's colours, which people with any colour vision tell apart; dashes and marks tell them apart without colour.
GREY, BLUE, GREEN, ORANGE, RED, PURPLE = "#808080", "#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7"
SKY = "#56b4e9"
COLOURS = (BLUE, SKY, GREEN, PURPLE, RED, GREY)
DASHES = ("", "6 3", "2 3", "8 3 2 3", "1 4", "12 4")
LEFT, RIGHT, TOP, BOTTOM = 62.0, 14.0, 14.0, 44.0
NO_LABEL = 20.0  # of the bottom, where the axis has no label
LINE, THIN = 1.8, 1.0  # width of a stroke, pixels
LEGEND_LINE, LETTER = 18.0, 6.6  # height of a line of the legend, width of a letter: pixels at 12
SLANT_DEG = 45  # of names that have no room side by side
ACROSS, DOWN = math.cos(math.pi / 4), math.sin(math.pi / 4)  # of a slanted name one pixel long
Table = tuple[Sequence[str], Sequence[Sequence[str]]]  # head and rows
FONT = 'font-family="system-ui, sans-serif" font-size="12"'


@dataclass
class Plot:
    """A plot; what is added later is drawn above what was added before.

    ``description`` says in a sentence what is to be seen, for whoever does not see it. ``table`` holds the same numbers.
    """

    title: str
    x: Axis
    y: Axis
    width: float = 640.0
    height: float = 320.0
    description: str = ""
    table: Table = ((), ())
    rigid: bool = False  # both axes have one scale: it is never drawn narrower
    _drawn: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Draw it as wide as there is room."""
        if not self.rigid:
            self.width = room_for(self.width)

    def line(
        self,
        xs: Sequence[float],
        ys: Sequence[float],
        label: str = "",
        number: int = 0,
        colour: str = "",
        width: float = LINE,
    ) -> Plot:
        """Draw a line through points; a value that is not finite leaves a gap."""
        style = _stroke(colour or COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)], width)
        self._key(label, f'<line x1="0" y1="6" x2="22" y2="6" {style}/>')
        for run in _runs(xs, ys):
            where = " ".join(f"{self._px(x)},{self._py(y)}" for x, y in run)
            self._drawn.append(f'<polyline points="{where}" fill="none" stroke-linejoin="round" {style}/>')
        return self

    def points(
        self,
        xs: Sequence[float],
        ys: Sequence[float],
        label: str = "",
        number: int = 0,
        colour: str = "",
        names: Sequence[str] = (),
        rows: Sequence[str] = (),
        links: Sequence[str] = (),
    ) -> Plot:
        """Draw points; ``names`` are shown when one is pointed at, ``rows`` (``CAMPAIGN/ROW``) tell which row each is.

        A click on a point leads where its link does.
        """
        fill = colour or COLOURS[number % len(COLOURS)]
        self._key(label, _mark(11, 6, fill, number))
        for place, (x, y) in enumerate(zip(xs, ys, strict=True)):
            if math.isfinite(x) and math.isfinite(y):
                name = escape(names[place]) if names else ""
                row = f' data-row="{escape(rows[place])}"' if rows else ""
                row += f' data-goto="{escape(links[place])}"' if links else ""
                self._drawn.append(_mark(self._px(x), self._py(y), fill, number, name, row))
        return self

    def bars(
        self,
        places: Sequence[float],
        values: Sequence[float],
        width: float,
        label: str = "",
        number: int = 0,
        colour: str = "",
        errors: Sequence[tuple[float, float]] = (),
    ) -> Plot:
        """Draw bars from zero (the axis's low end where it is logarithmic); ``errors`` are the ends of intervals."""
        fill = colour or COLOURS[number % len(COLOURS)]
        self._key(label, f'<rect x="3" y="0" width="16" height="12" fill="{fill}"/>')
        ground = self._py(max(self.y.low, 0.0) if not self.y.log else self.y.low)
        for place, value in zip(places, values, strict=True):
            if math.isfinite(value):
                told = f"<title>{escape(label)} {self.y.times * value:.4g}</title>"
                left, right, top = self._px(place - width / 2), self._px(place + width / 2), self._py(value)
                self._drawn.append(
                    f'<rect x="{left}" y="{min(top, ground)}" width="{round(right - left, 1)}" '
                    f'height="{round(abs(ground - top), 1)}" fill="{fill}">{told}</rect>'
                )
        for place, (low, high) in zip(places, errors, strict=False):
            self._whisker(self._px(place), self._py(low), self._py(high))
        return self

    def band(
        self, xs: Sequence[float], low: Sequence[float], high: Sequence[float], label: str, number: int = 0
    ) -> Plot:
        """Fill what is between two lines."""
        fill = f'fill="{COLOURS[number % len(COLOURS)]}" fill-opacity="0.25"'
        self._key(label, f'<rect x="3" y="0" width="16" height="12" {fill}/>')
        there = [f"{self._px(x)},{self._py(y)}" for x, y in zip(xs, high, strict=True)]
        back = [f"{self._px(x)},{self._py(y)}" for x, y in zip(xs, low, strict=True)]
        self._drawn.append(f'<polygon points="{" ".join(there + back[::-1])}" {fill}/>')
        return self

    def distance(self, x: float, low: float, high: float, text: str) -> Plot:
        """Mark how far two values are apart at a place, with the distance in words beside it."""
        place, ends = self._px(x), (self._py(low), self._py(high))
        self._whisker(place, *ends)
        left = x > (self.x.low + self.x.high) / 2
        # Not in the middle: what has one side runs there.
        where = f'x="{place - 7 if left else place + 7}" y="{0.75 * ends[0] + 0.25 * ends[1] + 4:.1f}"'
        anchor = "end" if left else "start"
        self._drawn.append(f'<text {where} text-anchor="{anchor}" font-weight="600">{escape(text)}</text>')
        return self

    def level(self, y: float, label: str) -> Plot:
        """Draw a dotted line across at a value, such as the noise."""
        style = 'stroke="currentColor" stroke-width="1.2" stroke-dasharray="2 3"'
        self._key(label, f'<line x1="0" y1="6" x2="22" y2="6" {style}/>')
        place = self._py(y)
        self._drawn.append(f'<line x1="{LEFT}" x2="{self.width - RIGHT}" y1="{place}" y2="{place}" {style}/>')
        return self

    def uprights(self, xs: Sequence[float], label: str, number: int, names: Sequence[str]) -> Plot:
        """Draw lines from bottom to top at places where something was done; ``names`` are shown when one is pointed at."""
        if xs:
            style = _stroke(COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)])
            self._key(label, f'<line x1="11" y1="-1" x2="11" y2="13" {style}/>')
        for x, name in zip(xs, names, strict=True):
            place = self._px(x)
            line = f'x1="{place}" x2="{place}" y1="{TOP}" y2="{self.height - BOTTOM}" {style}'
            self._drawn.append(f"<line {line}><title>{escape(name)}</title></line>")
        return self

    def svg(self) -> Markup:
        """Return it as SVG."""
        legend, lines = self._legend_drawn()
        extra = lines * LEGEND_LINE
        tall = round(self.height + extra + self._below() - (0.0 if self.x.label else NO_LABEL), 1)
        drawn = [legend, self._frame(), *self._drawn]
        return whole_svg(self.width, tall, drawn, self.title, self.description or self.title, -extra)

    def _px(self, x: float) -> float:
        return round(LEFT + self.x.share(x) * (self.width - LEFT - RIGHT), 1)

    def _py(self, y: float) -> float:
        share = min(max(self.y.share(y), -0.02), 1.02)
        return round(self.height - BOTTOM - share * (self.height - TOP - BOTTOM), 1)

    def _key(self, label: str, drawn: str) -> None:
        if label:
            self._legend.append((label, drawn))

    def _whisker(self, x: float, low: float, high: float) -> None:
        style = 'stroke="currentColor" stroke-width="1.2"'
        self._drawn.append(f'<line x1="{x}" x2="{x}" y1="{low}" y2="{high}" {style}/>')
        for y in (low, high):
            self._drawn.append(f'<line x1="{x - 4}" x2="{x + 4}" y1="{y}" y2="{y}" {style}/>')

    def _legend_drawn(self) -> tuple[str, int]:
        """Return the legend above the plot, and over how many lines it runs."""
        parts, x, line = [], 0.0, 1
        room = self.width - LEFT - RIGHT
        for label, drawn in self._legend_lines(room):
            width = 30 + LETTER * len(label) + 14
            if x and x + width > room:
                x, line = 0.0, line + 1
            parts.append((x, line, label, drawn))
            x += width
        if not parts:
            return "", 0
        lines = line
        placed = [
            f'<g transform="translate({LEFT + x:.0f} {-(lines - at + 1) * LEGEND_LINE + 4:.0f})">{drawn}'
            f'<text x="28" y="10">{escape(label)}</text></g>'
            for x, at, label, drawn in parts
        ]
        return "".join(placed), lines

    def _legend_lines(self, room: float) -> Iterator[tuple[str, str]]:
        """Return the entries of the legend; one that is longer than a line goes on below itself."""
        most = max(int((room - 44) / LETTER), 1)
        for label, drawn in self._legend:
            for number, part in enumerate(textwrap.wrap(label, most) or [""]):
                yield part, "" if number else drawn

    def _frame(self) -> str:
        bottom, right = self.height - BOTTOM, self.width - RIGHT
        faint = 'stroke="currentColor" stroke-opacity="0.15"'
        parts = []
        for value, text in self.y.ticks():
            y = self._py(value)
            parts.append(f'<line x1="{LEFT}" x2="{right}" y1="{y}" y2="{y}" {faint}/>')
            parts.append(f'<text x="{LEFT - 6}" y="{y + 4}" text-anchor="end">{escape(text)}</text>')
        for value, text in self._x_ticks():
            x = self._px(value)
            parts.append(f'<line x1="{x}" x2="{x}" y1="{bottom}" y2="{bottom + 4}" stroke="currentColor"/>')
            parts.append(self._x_tick(x, text))
        parts.append(f'<path d="M{LEFT} {TOP}V{bottom}H{right}" fill="none" stroke="currentColor"/>')
        middle = (LEFT + right) / 2
        parts.append(
            f'<text x="{middle}" y="{self.height - 8 + self._below():.1f}" text-anchor="middle">{escape(self.x.label)}</text>'
        )
        centre = (TOP + bottom) / 2
        parts.append(
            f'<text transform="translate(14 {centre}) rotate(-90)" text-anchor="middle">{escape(self.y.label)}</text>'
        )
        return "".join(parts)

    def _x_tick(self, x: float, text: str) -> str:
        bottom = self.height - BOTTOM
        if not self._below():
            return (
                f'<text x="{self._level_place(x, text)}" y="{bottom + 17}" text-anchor="middle">{escape(text)}</text>'
            )
        turned = f'transform="translate({x + 4} {bottom + 13}) rotate(-{SLANT_DEG})"'
        return f'<text {turned} text-anchor="end">{escape(text)}</text>'

    def _x_ticks(self) -> list[tuple[float, str]]:
        """Return the ticks along x; of names so many that they do not overlap, none longer than there is room."""
        ticks = self.x.ticks()
        if not self.x.names:
            return self._non_overlapping_ticks(ticks)
        letters = self._letters()
        short = [(place, text if len(text) <= letters else f"{text[: letters - 1]}…") for place, text in ticks]
        return short[:: math.ceil(LEGEND_LINE / self._room())]

    def _non_overlapping_ticks(self, ticks: list[tuple[float, str]]) -> list[tuple[float, str]]:
        """Return every tick, or every second and so on, that what is written at them does not overlap."""
        for step in range(1, len(ticks)):
            some = ticks[::step]
            ends = [(self._level_place(self._px(x), text), _half(text)) for x, text in some]
            if all(one + half <= other - its_half for (one, half), (other, its_half) in pairwise(ends)):
                return some
        return ticks[:1]

    def _level_place(self, x: float, text: str) -> float:
        """Return the middle of a level text at a tick: there, but for a text that the edge of the picture would cut."""
        return round(min(max(x, _half(text)), self.width - _half(text)), 1)

    def _room(self) -> float:
        """Pixels of a name along x."""
        return (self.width - LEFT - RIGHT) / len(self.x.names)

    def _letters(self) -> int:
        """How long a slanted name may be: the first begins within the picture."""
        return int((LEFT + self._room() / 2) / (LETTER * ACROSS))

    def _below(self) -> float:
        """Pixels for names that are slanted, because they have no room side by side."""
        longest = max((len(name) for name in self.x.names), default=0)
        if not longest or LETTER * (longest + 1) <= self._room():
            return 0.0
        return DOWN * LETTER * min(longest, self._letters())


def whole_svg(
    width: float, height: float, parts: Iterable[str], title: str, said: str = "", top: float = 0.0, more: str = FONT
) -> Markup:
    """Return a picture of parts whose texts are escaped; ``top`` is where it begins, ``more`` attributes it has besides."""
    words = f"<title>{escape(title)}</title>{f'<desc>{escape(said)}</desc>' if said else ''}"
    return Markup(  # noqa: S704 (texts are escaped)
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 {top:g} {width:g} {height:g}" role="img" width="{width:g}" '
        f'height="{height:g}" {more} fill="currentColor">{words}{"".join(parts)}</svg>'
    )


def _half(text: str) -> float:
    """Half the room of a level text, pixels: letters of some fonts are wider, by less than one of ten."""
    return 0.5 * LETTER * (len(text) + 1)


def _stroke(colour: str, dash: str, width: float = LINE) -> str:
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    return f'stroke="{colour}" stroke-width="{width}"{dashes}'


def _mark(x: float, y: float, fill: str, number: int, name: str = "", row: str = "") -> str:
    title = f"<title>{name}</title>" if name else ""
    if number % 3 == 1:
        return f'<rect x="{x - 3}" y="{y - 3}" width="6" height="6" fill="{fill}"{row}>{title}</rect>'
    if number % 3 == 2:
        return f'<path d="M{x} {y - 4}l4 7h-8z" fill="{fill}"{row}>{title}</path>'
    return f'<circle cx="{x}" cy="{y}" r="3" fill="{fill}"{row}>{title}</circle>'


def _runs(xs: Sequence[float], ys: Sequence[float]) -> list[list[tuple[float, float]]]:
    runs: list[list[tuple[float, float]]] = [[]]
    for x, y in zip(xs, ys, strict=True):
        if math.isfinite(x) and math.isfinite(y):
            runs[-1].append((x, y))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


ERROR, CORRECTED, INTERVAL = RED, BLUE, BLUE  # an interval is a band of a quarter of its colour, or a bar
BESIDE = SKY  # the second of two: the other side, the other version, the largest beside the mean
FITTED, HELD_OUT, SET_ASIDE, CHOSEN = GREY, GREEN, ORANGE, PURPLE  # what was done with a row
MEANINGS = {
    "error": ERROR,
    "corrected": CORRECTED,
    "interval": INTERVAL,
    "fitted": FITTED,
    "held-out": HELD_OUT,
    "set-aside": SET_ASIDE,
    "chosen": CHOSEN,
    "beside": BESIDE,
}


Group = tuple[
    str, int, str, Sequence[int], Sequence[str], Sequence[str]
]  # label, look, colour, which points, names, rows


def places_from_two_sides(
    places: Sequence[Sequence[float]],
    groups: Sequence[Group],
    about: str,
    table: Table = ((), ()),
    size: tuple[float, float] = (420.0, 320.0),
    titles: tuple[str, str] = ("From above", "From the side"),
) -> list[Plot]:
    """Draw places (N, 3), mm, from above and from the side; ``about`` goes on after each title."""
    out = []
    for title, across, up in ((titles[0], 0, 1), (titles[1], 0, 2)):
        xs, ys = ([place[axis] for place in places] for axis in (across, up))
        axes = around(f"{'xyz'[across]}, mm", xs), around(f"{'xyz'[up]}, mm", ys)
        plot = Plot(title, *axes, *size, f"{title}{about}", table)
        for label, number, colour, which, names, rows in groups:
            if len(which):
                plot.points([xs[k] for k in which], [ys[k] for k in which], label, number, colour, names, rows)
        out.append(plot)
    return out
