"""Time stamps as instruments write them: a clock, a date with a clock, with or without a spreadsheet's apostrophe.

Which readings are the same position: decided by the gaps between them, never by rounding.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from kilter_files.ground.errors import FileError

DAY_S = 86_400.0
SINCE_1970_S = 1e8  # no campaign lasts three years: such seconds count from 1970
CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,:](?P<f>\d{1,9}))?)?\s*(?P<half>[AaPp][Mm])?"
ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
DATES = (
    r"(?P<y>\d{4})[-/](?P<mo>\d{1,2})[-/](?P<d>\d{1,2})",
    r"(?P<d>\d{1,2})\.(?P<mo>\d{1,2})\.(?P<y>\d{4})",
    r"(?P<one>\d{1,2})(?P<mark>[-/])(?P<two>\d{1,2})(?P=mark)(?P<y>\d{4}|\d{2})",
)
STAMPS = [re.compile(CLOCK)] + [re.compile(rf"{day}(?:[T\s]\s*{CLOCK}{ZONE})?") for day in DATES]
DATE_FORMATS = {"MM/DD/YYYY": False, "DD/MM/YYYY": True}  # whether the day comes first


@dataclass(frozen=True)
class Stamp:
    """Seconds since midnight, or since 1970 when the stamp has a date.

    ``day_first`` says which of two numbers its text shows to be the day, None where it does not show it.
    """

    seconds: float
    dated: bool
    day_first: bool | None = None
    either: bool = False


def parse_stamp(text: str, day_first: bool = False) -> Stamp | None:
    """Return what a time stamp says, None for any other text.

    ``12:00:01.5``, ``12:00:01,5 PM``, ``2026-11-22T12:00:01.5Z``, ``22.11.2026 12:00``. Of ``11/22/2026`` the number above
    12 is the day; where none is, ``day_first`` decides, and the stamp is marked as ``either``.
    """
    text = text.strip().removeprefix("'").strip()
    match = next((found for stamp in STAMPS if (found := stamp.fullmatch(text))), None)
    if match is None:
        return None
    parts = match.groupdict()
    clock = _clock(parts)
    if clock is None:
        return None
    if parts.get("y") is None:
        return Stamp(clock, False)
    shown = _shown_order(parts)
    if parts.get("one"):
        first = day_first if shown is None else shown
        parts["d"], parts["mo"] = (parts["one"], parts["two"]) if first else (parts["two"], parts["one"])
    try:
        day = date(_year(str(parts["y"])), int(parts["mo"] or 0), int(parts["d"] or 0))
    except ValueError:
        return None
    midnight = datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()
    either = bool(parts.get("one")) and shown is None and parts["one"] != parts["two"]
    return Stamp(midnight + clock - _zone_s(parts.get("zone")), True, shown, either)


def parse_stamp_column(
    texts: Sequence[str],
    lines: Sequence[int],
    file: Path,
    column: str | int,
    date_format: str | None = None,
) -> list[Stamp]:
    """Return what a column of a file says; ``lines`` are those of its rows, where rows have lines.

    Day and month of ``date_format``, else as any row of the column shows them: 27 cannot be a month.

    Raises:
        FileError: a cell that is not a time stamp, or dates whose day and month nothing shows.

    """
    found = [parse_stamp(text) for text in texts]
    place = _Cells(texts, lines, file, column)
    wrong = next((row for row, stamp in enumerate(found) if stamp is None), None)
    if wrong is not None:
        raise place.fault(
            wrong,
            "is not a time stamp such as 12:00:01.5, 2026-11-22 12:00:01.5 or 22.11.2026 12:00:01",
            "Write it so, or give the unit of numbers.",
        )
    stamps = [stamp for stamp in found if stamp is not None]
    other = next((row for row, stamp in enumerate(stamps) if stamp.dated != stamps[0].dated), None)
    if other is not None:
        what = f"has {'a' if stamps[other].dated else 'no'} date, unlike the rows before"
        raise place.fault(other, what, "Give every row a date, or none.")
    return _with_one_order(stamps, place, date_format)


def _with_one_order(stamps: list[Stamp], place: _Cells, date_format: str | None) -> list[Stamp]:
    """The stamps with day and month in one order in all rows."""
    stated = None if date_format is None else DATE_FORMATS[date_format]
    shown = stated if stated is not None else next((s.day_first for s in stamps if s.day_first is not None), None)
    other = next((row for row, s in enumerate(stamps) if s.day_first not in (None, shown)), None)
    if other is not None:
        said = "'date_format'" if stated is not None else "other rows"
        raise place.fault(other, f"has day and month in another order than {said}", "Write all dates alike.")
    if shown is not None:
        return [found for text in place.texts if (found := parse_stamp(text, shown)) is not None]
    either = next((row for row, s in enumerate(stamps) if s.either), None)
    if either is not None:
        formats = " or ".join(f'"{name}"' for name in DATE_FORMATS)
        remedy = f"In the column map add date_format = {formats} beside its unit, or write it as 2026-11-22."
        raise place.fault(either, "may be day/month or month/day", remedy)
    return stamps


@dataclass(frozen=True)
class _Cells:
    """A column of a file, whose rows a refusal names."""

    texts: Sequence[str]
    lines: Sequence[int]
    file: Path
    column: str | int

    def fault(self, row: int, what: str, remedy: str) -> FileError:
        line = self.lines[row] if row < len(self.lines) else row + 1
        return FileError(
            f"{self.file}, line {line}, column {self.column!r}: {self.texts[row][:40]!r} {what}. {remedy}",
            file=str(self.file),
            line=line,
            column=self.column,
        )


def continuous_seconds(stamps: Sequence[Stamp]) -> list[float]:
    """Return stamps as seconds that go on: clocks without a date pass midnight."""
    out: list[float] = []
    add = 0.0
    for stamp in stamps:
        if not stamp.dated and out and stamp.seconds + add < out[-1] - DAY_S / 2:
            add += DAY_S
        out.append(stamp.seconds + add)
    return out


def times_of_rows(seconds: Sequence[float]) -> list[float]:
    """Return times of rows, s: since 1970 where they say so, so that files share one clock; else since the first row."""
    begin = 0.0 if seconds[0] > SINCE_1970_S else seconds[0]
    return [time - begin for time in seconds]


def _year(text: str) -> int:
    return int(text) + (2000 if len(text) == 2 else 0)


def _shown_order(parts: dict[str, str | None]) -> bool | None:
    """Whether the day is the first of two numbers, None where both may be months."""
    one, two = int(parts.get("one") or 0), int(parts.get("two") or 0)
    return None if max(one, two) <= 12 else one > 12


def _clock(parts: dict[str, str | None]) -> float | None:
    if parts.get("h") is None:
        return 0.0
    hours, minutes, seconds = int(parts["h"] or 0), int(parts["m"] or 0), int(parts["s"] or 0)
    if minutes > 59 or seconds > 60 or hours > 23 or (parts["half"] and not 1 <= hours <= 12):
        return None
    if parts["half"]:
        hours = hours % 12 + (12 if parts["half"].lower() == "pm" else 0)
    return 3600.0 * hours + 60.0 * minutes + seconds + float(f"0.{parts['f'] or 0}")


def _zone_s(zone: str | None) -> float:
    if not zone or zone == "Z":
        return 0.0
    digits = zone[1:].replace(":", "")
    return (1.0 if zone[0] == "+" else -1.0) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))


def clusters(values: Sequence[float], tolerance: float) -> list[int]:
    """Number the values so that those with no gap above the tolerance between them share a number."""
    labels = [0] * len(values)
    order = sorted(range(len(values)), key=values.__getitem__)
    for before, after in itertools.pairwise(order):
        labels[after] = labels[before] + (values[after] - values[before] > tolerance)
    return labels
