"""Time stamps as instruments write them: a clock, a date with a clock, with or without a spreadsheet's apostrophe."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from kilter_files.ground.errors import FileError

DAY_S = 86_400.0
CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2})(?:[.,:](?P<f>\d{1,9}))?)?\s*(?P<half>[AaPp][Mm])?"
ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
DATES = (r"(?P<y>\d{4})[-/](?P<mo>\d{1,2})[-/](?P<d>\d{1,2})", r"(?P<d>\d{1,2})\.(?P<mo>\d{1,2})\.(?P<y>\d{4})")
STAMPS = [re.compile(CLOCK)] + [re.compile(rf"{day}(?:[T\s]\s*{CLOCK}{ZONE})?") for day in DATES]


@dataclass(frozen=True)
class Stamp:
    """Seconds since midnight, or since 1970 when the stamp has a date."""

    seconds: float
    dated: bool


def stamp_of(text: str) -> Stamp | None:
    """Return what a time stamp says, None for any other text.

    ``12:00:01.5``, ``12:00:01,5 PM``, ``2026-11-22T12:00:01.5Z``, ``22.11.2026 12:00``; a date with two slashes is not
    understood, because day and month cannot be told apart in it.
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
    try:
        day = date(int(parts["y"]), int(parts["mo"]), int(parts["d"]))
    except ValueError:
        return None
    midnight = datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()
    return Stamp(midnight + clock - _zone_s(parts.get("zone")), True)


def stamps_of(texts: Sequence[str], lines: Sequence[int], file: Path, column: str | int) -> list[Stamp]:
    """Return what a column of a file says; ``lines`` are those of its rows, where rows have lines.

    Raises:
        FileError: a cell that is not a time stamp.

    """
    found = [stamp_of(text) for text in texts]
    wrong = next((row for row, stamp in enumerate(found) if stamp is None), None)
    if wrong is not None:
        line = lines[wrong] if wrong < len(lines) else wrong + 1
        raise FileError(
            f"{file}, line {line}, column {column!r}: {texts[wrong][:40]!r} is not a time stamp such as 12:00:01.5, "
            "2026-11-22 12:00:01.5 or 22.11.2026 12:00:01. Write it so, or give the unit of numbers.",
            file=str(file),
            line=line,
            column=column,
        )
    return [stamp for stamp in found if stamp is not None]


def seconds_of(stamps: Sequence[Stamp]) -> list[float]:
    """Return stamps as seconds that go on: clocks without a date pass midnight."""
    out: list[float] = []
    add = 0.0
    for stamp in stamps:
        if not stamp.dated and out and stamp.seconds + add < out[-1] - DAY_S / 2:
            add += DAY_S
        out.append(stamp.seconds + add)
    return out


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
