"""What a script may give: rows as a path, columns, an array or a DataFrame; times, days, and signs of joints.

Robots, campaigns, versions and jobs as a script names them: a result, an id, its beginning, a name, ``latest``.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from datetime import date, datetime
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, TypeAlias

from kilter_client.errors import UsageError
from kilter_client.results.record import Record
from kilter_files import prepare
from kilter_files.tables import CSV_TYPE, WHOLE_NUMBERS, Prepared

# A path, what `prepare` made, columns by name, a structured array, a 2-D array with `columns`, or a DataFrame.
Data: TypeAlias = "str | PathLike[str] | Prepared | Mapping[str, Any] | Any"


def prepare_rows(
    data: Data,
    columns: Sequence[str] | None = None,
    device: str | None = None,
    column_map: str | PathLike[str] | None = None,
    preset: str | None = None,
    euler: str | None = None,
    joints: str | PathLike[str] | None = None,
) -> Prepared:
    """Return the rows ready to send; columns have the contract's names, with their unit.

    Raises:
        UsageError: it is none of what can be given, or names of columns are missing.
        FileError: the file, or its map, is not what it should be.

    """
    if isinstance(data, Prepared):
        return data
    if isinstance(data, str | PathLike):
        paths = (None if one is None else Path(fspath(one)) for one in (column_map, joints))
        return prepare(Path(fspath(data)), device, *paths, preset=preset, euler=euler)
    idle = {"column_map": column_map, "preset": preset, "euler": euler, "joints": joints}
    given = next((name for name, value in idle.items() if value is not None), None)
    if given is not None:
        raise UsageError(f"{given}= belongs to a file: name the columns of arrays as the contract does (q1_deg, x_mm).")
    found = _columns(data, columns)
    lengths = {name: len(values) for name, values in found.items()}
    if len(set(lengths.values())) != 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise UsageError(f"Columns must have the same number of rows, and there must be one: {told or 'none given'}.")
    rows = [*range(1, next(iter(lengths.values())) + 1)]
    return Prepared(_csv(found), CSV_TYPE, tuple(found), len(rows))


def parse_time(given: datetime | date | str | None) -> str | None:
    """Read a time as ISO 8601 with its zone; without a zone it is that of this machine, of a day the noon.

    Raises:
        UsageError: it is not a time.

    """
    if given is None:
        return None
    try:
        at = datetime.fromisoformat(given) if isinstance(given, str) else given
    except ValueError:
        raise UsageError(f"{given!r} is not a time: give it as 2026-11-02 or 2026-11-02T14:30.") from None
    only_day = not isinstance(at, datetime) or (isinstance(given, str) and len(given) <= len("2026-11-02"))
    if only_day:
        noon = datetime(at.year, at.month, at.day, 12).astimezone()
        return min(noon, datetime.now().astimezone()).isoformat() if noon.date() == date.today() else noon.isoformat()
    assert isinstance(at, datetime)
    return (at if at.tzinfo is not None else at.astimezone()).isoformat()


def parse_day(given: date | str | None) -> str | None:
    """Read a day as ISO 8601.

    Raises:
        UsageError: it is not a day.

    """
    if given is None:
        return None
    try:
        return (date.fromisoformat(given) if isinstance(given, str) else given).isoformat()[: len("2026-11-02")]
    except ValueError:
        raise UsageError(f"{given!r} is not a day: give it as 2026-11-02.") from None


def parse_signs(given: Sequence[float] | str | None, count: int, whose: str) -> list[float]:
    """Read a sign of each joint as ``+,-,+`` or as numbers 1 and -1; without any, all are 1. ``whose`` joints: for a refusal.

    Raises:
        UsageError: they are not one for each joint.

    """
    if given is None:
        return [1.0] * count
    parts = [part.strip() for part in given.split(",")] if isinstance(given, str) else list(given)
    known = {"+": 1.0, "-": -1.0, 1: 1.0, -1: -1.0}
    if len(parts) != count or any(part not in known for part in parts):
        told = given if isinstance(given, str) else ",".join(map(str, parts))
        raise UsageError(f"--signs {told}: give + or - for each of the {count} joints of the {whose}.")
    return [known[part] for part in parts]


def default_name(data: Data) -> str:
    """Return what a campaign is called when nobody names it: the file's name."""
    return Path(fspath(data)).name if isinstance(data, str | PathLike) else "arrays"


def _columns(data: Any, columns: Sequence[str] | None) -> dict[str, list[Any]]:
    if isinstance(data, Mapping):
        return {str(name): _as_list(name, values) for name, values in data.items()}
    names = getattr(getattr(data, "dtype", None), "names", None)
    if names:  # a structured array
        return {name: data[name].tolist() for name in names}
    if hasattr(data, "columns") and hasattr(data, "iloc"):  # a pandas DataFrame
        return {str(name): data[name].tolist() for name in data.columns}
    shape = getattr(data, "shape", None)
    if shape is None or len(shape) != 2:
        raise UsageError(
            f"{type(data).__name__} holds no rows: give a path, a mapping of columns (q1_deg, x_mm, ...), a structured "
            "array, a pandas DataFrame, or an array of two dimensions with columns=."
        )
    if columns is None or len(columns) != shape[1]:
        given = "not given" if columns is None else f"{len(columns)} names"
        raise UsageError(f"An array of {shape[1]} columns needs columns= with a name for each; they are {given}.")
    return {name: data[:, k].tolist() for k, name in enumerate(columns)}


def _as_list(name: Any, values: Any) -> list[Any]:
    if isinstance(values, str | bytes) or not hasattr(values, "__len__"):
        raise UsageError(f"Column {name!r} is {type(values).__name__}, not a sequence of numbers.")
    found = values.tolist() if hasattr(values, "tolist") else list(values)
    if any(isinstance(one, list | tuple) for one in found):
        raise UsageError(
            f"Column {name!r} has more than one dimension: give a column for each number (x_mm, y_mm, z_mm)."
        )
    return found


def _csv(columns: Mapping[str, Sequence[Any]]) -> bytes:
    """Every digit of every number; NaN, None and pandas' NA are empty cells."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    cells = ([_cell(name, value) for value in values] for name, values in columns.items())
    writer.writerows(zip(*cells, strict=True))
    return out.getvalue().encode()


def _cell(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    try:
        number = math.nan if value is None else float(value)
    except (TypeError, ValueError):  # pandas' NA has no float; what else is not a number is refused by the server
        return "" if str(value) in ("<NA>", "NaT") else str(value)
    if math.isnan(number):
        return ""
    return str(int(number)) if name.startswith(WHOLE_NUMBERS) and number.is_integer() else repr(number)


ResourceReference: TypeAlias = str | Record
What = Literal["robot", "campaign", "version", "job"]

# Where an answer names the thing, the nearest first.
FIELDS: dict[str, tuple[str, ...]] = {
    "robot": ("name",),
    "campaign": ("campaign_id", "id"),
    "version": ("version_id", "id"),
    "job": ("job_id", "id"),
}
BEGINNINGS: dict[str, What] = {"cmp_": "campaign", "ver_": "version", "job_": "job"}


def reference(what: What, thing: ResourceReference) -> str:
    """Return the words that name a thing.

    Raises:
        UsageError: it is something else.

    """
    if isinstance(thing, str):
        return thing
    if isinstance(thing, Record):
        named = [str(thing[field]) for field in FIELDS[what] if thing.get(field)]
        fitting = [name for name in named if what == "robot" or BEGINNINGS.get(name[:4]) == what]
        if fitting and (what != "robot" or "convention" in thing):
            return fitting[0]
    raise UsageError(f"{thing!r} is not a {what}: give its name or id, or the result that made it.")


def references(what: What, things: ResourceReference | Sequence[ResourceReference]) -> list[str]:
    """Return the words that name one thing or several."""
    several = [things] if isinstance(things, str | Record) else things
    return [reference(what, thing) for thing in several]


def infer_kind(thing: ResourceReference, kind: What | None) -> What:
    """Return what a thing is, by its id or by the answer that it is.

    Raises:
        UsageError: a name alone does not say it.

    """
    if kind is not None:
        return kind
    words = (
        thing if isinstance(thing, str) else str(thing.get("version_id") or thing.get("campaign_id") or thing.get("id"))
    )
    if words[:4] in BEGINNINGS:
        return BEGINNINGS[words[:4]]
    if isinstance(thing, Record) and "convention" in thing:
        return "robot"
    raise UsageError(f"{thing!r} may name several things: say which with kind='robot', 'campaign' or 'version'.")
