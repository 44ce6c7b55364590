"""From numbers to places on paper, and the numbers that are written along an axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta

from kilter_service.contract.words import unit_of_length

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
