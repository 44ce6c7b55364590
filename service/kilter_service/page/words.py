"""How numbers, times and names are written: digits no finer than the uncertainty, units beside them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from markupsafe import Markup, escape

from kilter_files.look import why_unusual
from kilter_service.contract.fits import Parameter, split_nominal_and_moved
from kilter_service.contract.wording import said_of_chance, said_of_lengths, unit_of_length
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.naming import display_name, plural

NONE = "–"
MASSES = "load_error"  # carried beside effects that follow loads: nobody asks for it
WIDE = 2 * 1.96  # standard deviations of a 95 % interval
DIGITS = 3  # of a number whose uncertainty is not known
TICKED = re.compile(r"`([^`]+)`")
MINUTE, HOUR, DAY = 60.0, 3600.0, 86400.0


def number(value: float | None, digits: int = DIGITS) -> str:
    """Write a number with so many significant digits, without an exponent where it can be read without."""
    if value is None or not math.isfinite(value):
        return NONE
    if value == 0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    if decimals > 9:
        return f"{value:.{digits - 1}e}"
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def format_with_uncertainty(value: float | None, sigma: float | None, unit: str = "") -> str:
    """Write ``value ± sigma unit``, to the second digit of the uncertainty."""
    if value is None or not math.isfinite(value):
        return NONE
    after = f" {unit}" if unit and unit != "1" else ""
    if sigma is None or not math.isfinite(sigma) or sigma <= 0:
        return f"{number(value)}{after}"
    decimals = 1 - math.floor(math.log10(sigma))
    if decimals > 9:
        return f"{value:.3e} ± {sigma:.1e}{after}"
    return f"{_format_fixed(value, decimals)} ± {_format_fixed(sigma, decimals)}{after}"


def fine(value: float | None, sigma: float | None) -> str:
    """Write a value as finely as its uncertainty allows, without it."""
    return format_with_uncertainty(value, sigma).partition(" ±")[0]


def format_interval(low: float | None, high: float | None, unit: str = "") -> str:
    """Write an interval, to the second digit of its width."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return NONE
    after = f" {unit}" if unit and unit != "1" else ""
    decimals = 1 - math.floor(math.log10(high - low)) if high > low else DIGITS
    if decimals > 9:
        return f"{low:.3e} to {high:.3e}{after}"
    return f"{_format_fixed(low, decimals)} to {_format_fixed(high, decimals)}{after}"


def _format_fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"  # no -0.0


def mm(value: float | None) -> str:
    """Write a length in mm, below a tenth of one in µm: nobody counts zeros in front of an arm."""
    if value is None or not math.isfinite(value):
        return NONE
    if 0 < abs(value) < 0.1:
        return f"{number(value * 1e3, 2 if abs(value) < 0.01 else 3)} µm"
    return f"{number(value)} mm"


def format_in_shared_unit(value: float | None, largest: float | None) -> str:
    """Write a length in mm in the unit of another one: numbers that are compared share it."""
    if value is None or not math.isfinite(value) or largest is None or not math.isfinite(largest):
        return NONE
    return said_of_lengths(largest, value)[0]


def format_in_largest_unit(value: float | None, largest: float | None) -> str:
    """Write a length in mm in the unit of the largest one it stands beside, with digits of its own."""
    if value is None or not math.isfinite(value) or largest is None or not math.isfinite(largest):
        return mm(value)
    unit, scale = unit_of_length(largest)
    return f"{number(scale * value)} {unit}"


def unit(largest: float | None) -> str:
    """Return the unit of a column of lengths in mm, for its head."""
    return unit_of_length(largest)[0] if largest is not None and math.isfinite(largest) else "mm"


def bare(value: float | None, largest: float | None) -> str:
    """Write a length in mm below a head that names the unit."""
    return format_in_largest_unit(value, largest).partition(" ")[0]


def largest(lengths: Iterable[float | None]) -> float | None:
    """Return the largest size of those that are known; None: none is."""
    return max((abs(one) for one in lengths if one is not None and math.isfinite(one)), default=None)


def in_one_unit(rows: Sequence[Sequence[float | None]]) -> list[list[str]]:
    """Write a table of lengths in mm, all in the unit of the largest of them."""
    most = largest(one for row in rows for one in row)
    return [[format_in_largest_unit(one, most) for one in row] for row in rows]


def in_columns(rows: Sequence[Sequence[float | None]]) -> tuple[str, list[list[str]]]:
    """Write a table of lengths in mm below heads that name the unit of the largest of them, which comes first."""
    most = largest(one for row in rows for one in row)
    return unit(most), [[bare(one, most) for one in row] for row in rows]


def parameter_sigma(found: Parameter) -> float | None:
    """Return the standard deviation that belongs to the interval of a parameter: of a profile or a bootstrap, by its width."""
    if found.lower is None or found.upper is None or found.interval_from == "sigma":
        return found.sigma
    return (found.upper - found.lower) / WIDE


def chance(value: float) -> str:
    """Write a probability: as a number where people read it so, as a power of ten where it is tiny."""
    return said_of_chance(value)


def format_value_with_interval(value: float, low: float | None, high: float | None, most: float | None = None) -> str:
    """Write a length in mm with its interval to the second digit of its width, in the unit of ``most`` or of their largest."""
    if low is None or high is None or not high > low:
        return format_in_largest_unit(value, most)
    unit, scale = unit_of_length(max(abs(value), abs(low), abs(high)) if most is None else most)
    decimals = max(1 - math.floor(math.log10(scale * (high - low))), 0)
    one, first, last = (_format_fixed(scale * end, decimals) for end in (value, low, high))
    return f"{one} {unit} ({first} to {last})"


def age(moment: datetime | None) -> str:
    """Write how long ago something was."""
    if moment is None:
        return NONE
    seconds = (utc_now() - moment).total_seconds()
    for size, name in ((DAY, "day"), (HOUR, "hour"), (MINUTE, "minute")):
        if seconds >= size:
            return f"{plural(int(seconds // size), name)} ago"
    return "just now"


def duration(seconds: float) -> str:
    """Write how long something took."""
    if seconds < 2 * MINUTE:
        return f"{number(seconds, 2)}\u00a0s"
    return f"{seconds / MINUTE:.0f}\u00a0min" if seconds < 2 * HOUR else f"{number(seconds / HOUR, 2)}\u00a0h"


def moment(at: datetime | None) -> str:
    """Write a time in UTC, to the minute."""
    return NONE if at is None else f"{at:%Y-%m-%d %H:%M} UTC"


def percent(value: float | None) -> str:
    """Write a share as percent."""
    return NONE if value is None else f"{100 * value:.0f} %"


def count(value: int | None) -> str:
    """Write a count with a thin space between thousands."""
    return NONE if value is None else f"{value:,}".replace(",", "\u202f")


def left_out(rows: int | None) -> str:
    """Say how many rows an error leaves out; nothing where that is not known."""
    return "" if rows is None else "no row left out" if rows == 0 else f"{plural(rows, 'row')} left out"


def render_backticks_as_code(text: str) -> Markup:
    """Show what stands between backticks as code."""
    return Markup(TICKED.sub(r"<code>\1</code>", str(escape(text))))  # noqa: S704 (escaped before)


def validation_words(error: Any, skip: int = 0, most: int = 5) -> str:
    """Say where a document is not as it must be, and why; ``skip`` is how much of each place is left out."""
    return "; ".join(f"{'.'.join(map(str, one['loc'][skip:]))}: {one['msg']}" for one in error.errors()[:most])


def joined_by_and(names: Sequence[str]) -> str:
    """Join names by commas and *and*."""
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)


def of_joints(numbers: Sequence[int]) -> str:
    """Name joints by their numbers."""
    return f"joint{'s' if len(numbers) > 1 else ''} {joined_by_and([str(number) for number in numbers])}"


def list_effects(ids: Sequence[str], none: str = "geometry only") -> str:
    """List the effects of a model; that its masses count as uncertain is said apart."""
    own = ", ".join(name for name in ids if name != MASSES) or none
    return f"{own}; masses uncertain" if MASSES in ids else own


FILTERS: Mapping[str, Callable[..., Any]] = {
    "number": number,
    "mm": mm,
    "within": format_value_with_interval,
    "like": format_in_shared_unit,
    "beside": format_in_largest_unit,
    "unit": unit,
    "bare": bare,
    "largest": largest,
    "sigma_of": parameter_sigma,
    "chance": chance,
    "age": age,
    "moment": moment,
    "percent": percent,
    "count": count,
    "why_unusual": why_unusual,
    "measured": format_with_uncertainty,
    "fine": fine,
    "between": format_interval,
    "duration": duration,
    "ticked": render_backticks_as_code,
    "stayed": split_nominal_and_moved,
    "left_out": left_out,
    "called": display_name,
    "list_effects": list_effects,
}
