"""The table [columns] of a column map: single columns, and patterns that stand for one column per joint or marker.

One table of a TOML column map, read key by key so that nothing in it goes unnoticed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, did_you_mean
from kilter_files.ground.time_stamps import DATE_FORMATS
from kilter_files.ground.units import TIMESTAMP, UNKNOWN, column_unit, converter, units_like

PLAIN_JOINT = re.compile(r"q\d+")
NUMBERED = ("q", "link", "cmd", "qd", "qdd", "tau", "dir", "m")
NO_CONTRACT_COLUMN = (
    "is not a contract column; those are q1_deg or _rad, x_mm y_mm z_mm, qw qx qy qz, m1x_mm, link1_deg, t_s, tau1_nm, dir1, "
    "payload_kg, payload_com_x_mm, fx_n, mx_nm, temperature_c, base_tilt_x_deg, session, pose_id, sx_mm, tipx_mm, socket_id, "
    "plane_id, bar_id, bar_mm, each with its unit in the name"
)
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Column:
    """One contract column: ``scale * number + offset`` in the source's unit, then converted; or a constant.

    ``still_below`` makes a speed a direction: its sign, and the one before where the speed is not above it.
    ``date_format`` says which of two numbers of a date is the day.
    """

    target: str
    source: str | int | None
    unit: str
    scale: float = 1.0
    offset: float = 0.0
    value: float | None = None
    still_below: float | None = None
    date_format: str | None = None


@dataclass(frozen=True)
class Pattern:
    """Columns that differ in a number, written ``*`` on both sides; one factor and offset for all, or one for each."""

    place: str
    target: str
    source: str
    unit: str
    scales: Numbers = ()
    offsets: Numbers = ()
    still_below: float | None = None


Columns = tuple[Column | Pattern, ...]


def contract_columns(names: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns whose names are the contract's; a program's targets, ``q1``, are in degrees."""
    named = [(name, column_unit(name)) for name in names]
    plain = tuple(Column(name, name, unit) for name, unit in named if unit is not None)
    return plain or tuple(Column(f"{name}_deg", name, "deg") for name in names if PLAIN_JOINT.fullmatch(name))


def read_columns(top: Section, key: str = "columns") -> Columns:
    """Read the table of columns.

    Raises:
        FileError: no table, a target that is not a contract column, units that do not fit.

    """
    section = top.child_section(key)
    if section is None or not section.names():
        raise top.error(f'needs a table [{key}] such as q1_deg = {{ from = "joint 1", unit = "rad" }}')
    return tuple(_pattern(section, target) if "*" in target else _column(section, target) for target in section.names())


def expand_patterns(columns: Columns, choices: Sequence[str], map_path: Path, file: Path) -> tuple[Column, ...]:
    """Return single columns: each pattern becomes one per matching name of the file; what is named singly wins.

    Raises:
        FileError: no name matches, a number is missing, or lists of another length.

    """
    single = {column.target.partition("_")[0] for column in columns if isinstance(column, Column)}
    out: list[Column] = []
    for column in columns:
        if isinstance(column, Column):
            out.append(column)
        else:
            out += [
                one for one in _expand(column, choices, map_path, file) if one.target.partition("_")[0] not in single
            ]
    return tuple(out)


def _expand(pattern: Pattern, choices: Sequence[str], map_path: Path, file: Path) -> list[Column]:
    def wrong(why: str) -> FileError:
        return FileError(f"{map_path}, {pattern.place}: {why}.", file=str(map_path), key=pattern.place)

    found = _numbered_matches(pattern.source, choices)
    if not found:
        raise wrong(
            f"no column of {file} is called {pattern.source!r} with a number for the *; it has {_shortened_list(choices)}"
        )
    numbers = [number for number, _ in found]
    start = min(numbers[0], 1)
    if numbers != list(range(start, start + len(numbers))):
        listed = ", ".join(name for _, name in found)
        raise wrong(
            f"{pattern.source!r} finds {listed}, which are not numbered 1, 2, 3, ... (or from 0). Name the columns one by one, "
            f'{pattern.target.replace("*", "1")} = {{ from = "{found[0][1]}", ... }}'
        )
    for what, values in (("sign, scale", pattern.scales), ("offset", pattern.offsets)):
        if len(values) > 1 and len(values) != len(found):
            raise wrong(f"{len(values)} numbers under {what}, but {len(found)} columns; give one, or one for each")
    return [
        Column(
            pattern.target.replace("*", str(k + 1)),
            name,
            pattern.unit,
            _nth(pattern.scales, k, 1.0),
            _nth(pattern.offsets, k, 0.0),
            None,
            pattern.still_below,
        )
        for k, (_, name) in enumerate(found)
    ]


def _numbered_matches(source: str, choices: Sequence[str]) -> list[tuple[int, str]]:
    before, _, after = source.partition("*")
    shape = re.compile(re.escape(before) + r"0*(\d{1,3})" + re.escape(after))
    return sorted((int(match[1]), name) for name in choices if (match := shape.fullmatch(name)))


def _shortened_list(choices: Sequence[str]) -> str:
    return ", ".join(choices[:30]) + (" ..." if len(choices) > 30 else "")


def _nth(values: Numbers, k: int, default: float) -> float:
    return default if not values else values[0] if len(values) == 1 else values[k]


def _column(columns: Section, target: str) -> Column:
    wanted = column_unit(target)
    if wanted is None:
        raise columns.error(NO_CONTRACT_COLUMN, target)
    section = columns.child_section(target)
    assert section is not None
    source, value = section.column("from"), section.number("value")
    unit, scale, offset = section.text("unit"), section.number("scale"), section.number("offset")
    sign, still, dates = section.number("sign"), section.number("still_below"), section.text("date_format")
    section.finish()
    if source == UNKNOWN:
        raise section.error("the draft could not determine which column this is: name it, or delete the line", "from")
    if (source is None) == (value is None):
        raise section.error("needs either 'from' (a column of the file) or 'value' (a constant)")
    if value is not None and (unit or scale or offset or sign):
        raise section.error(f"a constant is already in the target's unit: give 'value' alone, in {wanted or '1'}")
    if sign not in (None, 1.0, -1.0) or scale == 0:
        raise section.error("'sign' is 1 or -1, 'scale' is not 0")
    _check_still(section, target, source, still)
    _check_unit(section, target, wanted, unit, value)
    if unit == TIMESTAMP and (scale or sign or offset):
        raise section.error("a time stamp takes no sign, scale or offset: give 'from' and unit = \"timestamp\"")
    if dates is not None and (unit != TIMESTAMP or dates.upper() not in DATE_FORMATS):
        raise section.error(f'one of {", ".join(DATE_FORMATS)}, beside unit = "timestamp"', "date_format")
    dates = dates and dates.upper()
    return Column(target, source, unit or wanted, (scale or 1.0) * (sign or 1.0), offset or 0.0, value, still, dates)


def _pattern(columns: Section, target: str) -> Pattern:
    section = columns.child_section(target)
    assert section is not None
    source, unit = section.text("from"), section.text("unit")
    scales, offsets, signs = (section.numbers(key) for key in ("scale", "offset", "sign"))
    still = section.number("still_below")
    section.finish()
    if source == UNKNOWN:
        raise section.error(
            "the draft could not determine which columns these are: name them, or delete the line", "from"
        )
    if source is None or source.count("*") != 1 or target.count("*") != 1:
        raise section.error('a pattern has one * on either side, for example q*_deg = { from = "A*", unit = "deg" }')
    if unit == UNKNOWN:
        raise section.error("the draft could not determine the unit: fill it in", "unit")
    named = _with_unit(target, unit)
    wanted = None if named is None else column_unit(named.replace("*", "1"))
    if named is None or wanted is None:
        stems = ", ".join(f"{stem}*" for stem in NUMBERED[:-1])
        raise section.error(
            f"is not a pattern of contract columns; those are {stems}, m*x_mm, each with its unit or 'unit'"
        )
    if any(sign not in (1.0, -1.0) for sign in signs) or 0.0 in scales:
        raise section.error("'sign' is 1 or -1, 'scale' is not 0")
    if len(signs) > 1 < len(scales) != len(signs):
        raise section.error("'sign' and 'scale' have different numbers of entries")
    _check_still(section, target, source, still)
    _check_unit(section, named, wanted, unit, None)
    count = max(len(signs), len(scales))
    factors = tuple(_nth(signs, k, 1.0) * _nth(scales, k, 1.0) for k in range(count))
    return Pattern(section.place, named, source, unit or wanted, factors, offsets, still)


def _with_unit(target: str, unit: str | None) -> str | None:
    """Return the target with a unit in its name: its own, else the one of ``unit``, else one that ``unit`` can become."""
    if column_unit(target.replace("*", "1")) is not None:
        return target
    endings = ("deg", "rad", "mm", "m", "deg_s", "rad_s", "mm_s", "m_s", "deg_s2", "rad_s2", "mm_s2", "m_s2", "nm", "n")
    named = [(name, column_unit(name.replace("*", "1"))) for name in (f"{target}_{ending}" for ending in endings)]
    known = [(name, found) for name, found in named if found is not None]
    exact = [name for name, found in known if found == unit]
    near = [name for name, found in known if unit is not None and converter(unit, found) is not None]
    return next(iter(exact + near), known[0][0] if known else None)


def _check_still(section: Section, target: str, source: str | int | None, still: float | None) -> None:
    if still is not None and (not target.startswith("dir") or source is None or still < 0):
        raise section.error(
            "'still_below' makes a direction of a speed: for dir1 with 'from', 0 or more", "still_below"
        )


def _check_unit(section: Section, target: str, wanted: str, unit: str | None, value: float | None) -> None:
    if unit == UNKNOWN:
        raise section.error(f"the draft could not determine the unit: one of {', '.join(units_like(wanted))}", "unit")
    if not wanted and unit:
        raise section.error(f"{target} is a plain number and takes no unit", "unit")
    if not wanted or value is not None or (unit == TIMESTAMP and wanted == "s"):
        return
    choices = ", ".join((*units_like(wanted), *([TIMESTAMP] if wanted == "s" else [])))
    if unit is None:
        raise section.error(f"needs the unit the file has it in: unit = one of {choices}")
    if converter(unit, wanted) is None:
        raise section.error(f"{unit!r} cannot become {wanted!r}; use one of {choices}", "unit")


class Section:
    """A table of the map: typed reading, and the refusal of every key nobody asked for."""

    def __init__(self, path: Path, place: str, content: Any) -> None:
        self.path = path
        self.place = place
        if not isinstance(content, Mapping):
            raise self.error(f"must be a table, not {content!r}")
        self._content = content
        self._known: list[str] = []

    def error(self, why: str, key: str = "") -> FileError:
        """Build the error that names the map, the place in it and what is wrong."""
        place = ".".join(part for part in (self.place, key) if part)
        return FileError(f"{self.path}, {place or 'top level'}: {why}.", file=str(self.path), key=place)

    def raw(self, key: str) -> Any:
        """Return a key's value as it stands, None when absent."""
        self._known.append(key)
        return self._content.get(key)

    def text(self, key: str, default: str | None = None) -> str | None:
        """Return a text."""
        value = self.raw(key)
        if value is not None and not isinstance(value, str):
            raise self.error(f"must be text, not {value!r}", key)
        return default if value is None else value

    def number(self, key: str) -> float | None:
        """Return a number."""
        value = self.raw(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise self.error(f"must be a number, not {value!r}", key)
        return None if value is None else float(value)

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return one number or a list of them, empty when absent."""
        value = self.raw(key)
        values = value if isinstance(value, list) else [] if value is None else [value]
        if any(isinstance(item, bool) or not isinstance(item, int | float) for item in values):
            raise self.error(f"must be a number or a list of numbers, not {value!r}", key)
        return tuple(float(item) for item in values)

    def count(self, key: str, default: int) -> int:
        """Return a whole number, zero or more."""
        value = self.raw(key)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self.error(f"must be a whole number from 0, not {value!r}", key)
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self.raw(key)
        if value is not None and not isinstance(value, bool):
            raise self.error(f"must be true or false, not {value!r}", key)
        return default if value is None else value

    def column(self, key: str) -> str | int | None:
        """Return the name or the index of a column."""
        value = self.raw(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, str | int)):
            raise self.error(f"must be a column's name or its index from 0, not {value!r}", key)
        return value

    def items(self, key: str) -> list[Any]:
        """Return a list, empty when absent."""
        value = self.raw(key)
        if value is not None and not isinstance(value, list):
            raise self.error(f"must be a list, not {value!r}", key)
        return list(value or ())

    def child_section(self, key: str) -> Section | None:
        """Return the table under ``key``, None when absent."""
        value = self.raw(key)
        return None if value is None else Section(self.path, ".".join(filter(None, (self.place, key))), value)

    def child_sections(self, key: str) -> list[Section]:
        """Return the table under ``key`` or, where it stands several times as ``[[key]]``, each of them, numbered from 1."""
        value, place = self.raw(key), ".".join(filter(None, (self.place, key)))
        if not isinstance(value, list):
            return [] if value is None else [Section(self.path, place, value)]
        return [Section(self.path, f"{place} {number}", one) for number, one in enumerate(value, 1)]

    def names(self) -> list[str]:
        """Return every key of the table."""
        return list(self._content)

    def finish(self) -> None:
        """Refuse the keys that were never asked for.

        Raises:
            FileError: an unknown key, with the nearest known one.

        """
        for key in self._content:
            if key not in self._known:
                known = sorted(set(self._known))
                raise self.error(f"unknown key{did_you_mean(key, known)}; known are {', '.join(known)}", key)
