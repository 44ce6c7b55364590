"""The column names of observations: what each means, its unit, and which are refused."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from kilter_core.errors import ObservationError
from kilter_service.contract.columns import (
    BASE,
    CONTACTS,
    JOINT_UNITS,
    LENGTHS,
    LOAD_PARTS,
    LOAD_UNITS,
    NAMED,
    PIXEL_UNITS,
    PIXELS,
    PLAIN_UNITS,
    TILT_UNITS,
    TILTS,
    TOGETHER,
)
from kilter_service.ground.limits import MAX_COLUMNS, MAX_NAME

_JOINT = re.compile(r"(q|qd|qdd|link|cmd|tau|dir)([1-9][0-9]?)(?:_(\w+))?")
_TILT = re.compile(r"tilt(0|[1-9][0-9]?)([xyz])(?:_(\w+))?")
_LOAD = re.compile(r"load([1-9][0-9]?)_(kg|[xyz]|[fm][xyz])(?:_(\w+))?")
_PIXEL = re.compile(r"(s?[uv])([1-9][0-9]{0,2})(?:_(\w+))?")
_MARKER = re.compile(r"m([1-9][0-9]?)([xyz])(?:_(\w+))?")
_PLAIN = re.compile(rf"({'|'.join(sorted(PLAIN_UNITS, key=len, reverse=True))})(?:_(\w+))?")


@dataclass(frozen=True)
class Column:
    """A column: its quantity, the joint or marker it belongs to (from 0, or the base), and the factor that brings it to SI."""

    name: str
    quantity: str
    number: int | None
    factor: float

    @property
    def may_be_empty(self) -> bool:
        """Whether a cell may be missing: markers and corners can be out of sight, a tip or joint is looked at in some rows."""
        return self.quantity.startswith(("marker_", "tip")) or self.quantity in (*TILTS, *PIXELS)

    @property
    def is_integer(self) -> bool:
        """Whether the cells are whole numbers."""
        return self.quantity in ("dir", "session", "pose_id", "row", *CONTACTS, *NAMED)


def check_names(names: Sequence[str]) -> None:
    """Check the names as a whole before any of them is parsed.

    Raises:
        ObservationError: too many or too long names, an empty one, or one that appears twice.

    """
    if len(names) > MAX_COLUMNS:
        raise ObservationError(
            f"The upload has {len(names)} columns, at most {MAX_COLUMNS} are allowed: leave out what is not a measurement."
        )
    seen: set[str] = set()
    for name in names:
        if len(name) > MAX_NAME:
            raise refuse(
                f"Column {name[:MAX_NAME]!r}... has a name of more than {MAX_NAME} characters.", name[:MAX_NAME]
            )
        if not name.strip() or name != name.strip():
            raise refuse(f"Column {name!r} is empty or has spaces around it: name it without.", name)
        if name in seen:
            raise refuse(f"Column {name!r} appears twice: keep one of them.", name)
        seen.add(name)


def read_columns(names: Sequence[str], kinds: Sequence[str]) -> tuple[Column, ...]:
    """Parse the column names of a file for a robot with joints of these ``kinds``.

    Raises:
        ObservationError: a column twice, unknown, without a unit or with a wrong one, or a group that is not complete.

    """
    columns: dict[tuple[str, int | None], Column] = {}
    for name in names:
        column = _read(name, kinds)
        key = (column.quantity, column.number)
        if key in columns:
            other = columns[key].name
            what = "appears twice" if other == name else f"says the same as {other!r}"
            raise refuse(f"Column {name!r} {what}: keep one of them.", name)
        columns[key] = column
    _complete(columns, kinds)
    return tuple(columns.values())


def has(columns: Iterable[Column], quantity: str) -> bool:
    """Whether there is a column of a quantity."""
    return any(column.quantity == quantity for column in columns)


def refuse(message: str, column: str, **context: Any) -> ObservationError:
    """Return the error that names a column."""
    return ObservationError(message, column=column, **context)


def _read(name: str, kinds: Sequence[str]) -> Column:
    if match := _JOINT.fullmatch(name):
        return _joint(name, match[1], int(match[2]), match[3] or "", kinds)
    if match := _TILT.fullmatch(name):
        number, stem = int(match[1]), f"tilt{match[1]}{match[2]}"
        _of_joint(name, number, kinds)
        place = number - 1 if number else BASE
        return Column(name, f"tilt_{match[2]}", place, _factor(name, stem, match[3] or "", TILT_UNITS))
    if match := _LOAD.fullmatch(name):
        _of_joint(name, int(match[1]), kinds)
        stem, quantity = f"load{match[1]}_{match[2]}", f"load_{match[2]}"
        return Column(name, quantity, int(match[1]) - 1, _factor(name, stem, match[3] or "", LOAD_UNITS[quantity]))
    if match := _PIXEL.fullmatch(name):
        factor = _factor(name, f"{match[1]}{match[2]}", match[3] or "", PIXEL_UNITS)
        return Column(name, f"pixel_{match[1]}", int(match[2]) - 1, factor)
    if match := _MARKER.fullmatch(name):
        factor = _factor(name, f"m{match[1]}{match[2]}", match[3] or "", LENGTHS)
        return Column(name, f"marker_{match[2]}", int(match[1]) - 1, factor)
    if match := _PLAIN.fullmatch(name):
        return Column(name, match[1], None, _factor(name, match[1], match[2] or "", PLAIN_UNITS[match[1]]))
    near = get_close_matches(name, _known_column_names(kinds), n=3)
    hint = f"Near it: {', '.join(near)}." if near else "The reference of observations lists all columns."
    raise refuse(f"Column {name!r} is unknown. {hint}", name, near=near)


def _joint(name: str, quantity: str, number: int, unit: str, kinds: Sequence[str]) -> Column:
    _of_joint(name, number, kinds)
    units = JOINT_UNITS[quantity][kinds[number - 1] == "prismatic"]
    return Column(name, quantity, number - 1, _factor(name, f"{quantity}{number}", unit, units))


def _of_joint(name: str, number: int, kinds: Sequence[str]) -> None:
    if number > len(kinds):
        raise refuse(f"Column {name!r} is of joint {number}, the robot has {len(kinds)} joints.", name)


def _factor(name: str, stem: str, unit: str, units: dict[str, float]) -> float:
    if unit in units:
        return units[unit]
    allowed = " or ".join(repr(f"{stem}_{u}" if u else stem) for u in units)
    what = f"has the unit {unit!r}" if unit else "has no unit"
    raise refuse(f"Column {name!r} {what}: name it {allowed}, and give its values in that unit.", name)


def _complete(columns: dict[tuple[str, int | None], Column], kinds: Sequence[str]) -> None:
    present = {quantity for quantity, _ in columns}
    for quantity in JOINT_UNITS:
        if quantity != "q" and quantity not in present:
            continue
        for joint, kind in enumerate(kinds):
            if (quantity, joint) not in columns:
                unit = next(iter(JOINT_UNITS[quantity][kind == "prismatic"]))
                missing = f"{quantity}{joint + 1}_{unit}".rstrip("_")
                raise refuse(f"Column {missing!r} is missing: give it for all {len(kinds)} joints.", missing)
    for group in TOGETHER:
        _whole(group, [part for part in group if part in present])
    for group, link in {(group, link) for q, link in columns for group in LOAD_PARTS if q in group}:
        parts = [f"load{(link or 0) + 1}{part.removeprefix('load')}" for part in group]
        _whole(parts, [name for name, part in zip(parts, group, strict=True) if (part, link) in columns])
    for marker in {number for quantity, number in columns if quantity.startswith("marker_")}:
        parts = [f"m{(marker or 0) + 1}{axis}" for axis in "xyz"]
        _whole(parts, [part for part, axis in zip(parts, "xyz", strict=True) if (f"marker_{axis}", marker) in columns])
    for corner in sorted({number for q, number in columns if q in PIXELS and number is not None}):
        _whole_corner(columns, corner)
    _conflicts(present, {number for quantity, number in columns if quantity == "marker_x" and number is not None})


def _whole_corner(columns: dict[tuple[str, int | None], Column], corner: int) -> None:
    for own, other in (("u", "v"), ("v", "u"), ("su", "sv"), ("sv", "su"), ("su", "u")):
        if (f"pixel_{own}", corner) in columns and (f"pixel_{other}", corner) not in columns:
            absent = f"{other}{corner + 1}_px"
            raise refuse(f"Column {absent!r} is missing: both coordinates of a corner belong together.", absent)


def _whole(group: Sequence[str], there: Sequence[str]) -> None:
    missing = [part for part in group if part not in there]
    if there and missing:
        raise refuse(f"Column {missing[0]!r} is missing: {', '.join(group)} belong together.", missing[0])


def _conflicts(present: set[str], markers: set[int]) -> None:
    if (held := present & set(CONTACTS)) and (seen := present & {"x", "marker_x"}):
        raise refuse(
            f"Column {sorted(held)[0]!r} cannot go with a measured tool ({'x' if 'x' in seen else 'm1x'}): give what held the "
            "tool or where an instrument saw it, in two campaigns.",
            sorted(held)[0],
        )
    if "payload_com_x" in present and "payload" not in present:
        raise refuse(
            "Column 'payload_kg' is missing: payload_com_x, _y, _z say where the payload has its centre, not how heavy it is.",
            "payload_kg",
        )
    if "tipx" in present and not markers:
        raise refuse("Column 'tipx' is missing its markers: a tip is digitised while they are seen.", "tipx")
    if {"qw", "phi"} <= present:
        raise refuse("Column 'phi' says the same as 'qw': give the orientation once.", "phi")
    if markers and "x" in present:
        raise refuse("Column 'x' cannot go with markers: give the tool's position or the markers, in two uploads.", "x")
    if "qw" in present | ({"qw"} if "phi" in present else set()) and "x" not in present:
        raise refuse("Column 'x' is missing: an orientation needs its position.", "x")
    if markers and max(markers) + 1 != len(markers):
        absent = min(set(range(max(markers))) - markers) + 1
        raise refuse(f"Column 'm{absent}x' is missing: number the markers 1, 2, 3, ... without a gap.", f"m{absent}x")


def _known_column_names(kinds: Sequence[str]) -> list[str]:
    names = [f"{stem}_{unit}".rstrip("_") for stem, units in PLAIN_UNITS.items() for unit in units]
    for quantity, units_of in JOINT_UNITS.items():
        names += [
            f"{quantity}{joint + 1}_{unit}".rstrip("_")
            for joint, kind in enumerate(kinds)
            for unit in units_of[kind == "prismatic"]
        ]
    names += [f"tilt{place}{axis}_{unit}" for place in range(len(kinds) + 1) for axis in "xyz" for unit in TILT_UNITS]
    return names
