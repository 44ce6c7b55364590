"""The column map of a dropped file as a form: which column of the file is which of Kilter's, in which unit."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_files.ground.units import TIMESTAMP, UNKNOWN, column_unit, converter, units_like
from kilter_files.maps.column_map import BARE_PATTERN
from kilter_service.contract.columns import JOINT_UNITS, PLAIN_UNITS, TILT_UNITS
from kilter_service.ground.errors import ServiceError

NUMBER = re.compile(r"\d+")
MARKERS = 4
OF_JOINTS = {
    "q": "reading", "link": "link-side encoder", "cmd": "command", "dir": "direction it came from", "qd": "speed",
    "qdd": "acceleration", "tau": "torque",
}  # fmt: skip
OF_ROWS = {
    "Position": ("x", "y", "z", "sx", "sy", "sz"),
    "Orientation": ("qw", "qx", "qy", "qz", "phi", "theta", "psi"),
    "Row": (
        "t",
        "pose_id",
        "session",
        "payload",
        "payload_com_x",
        "payload_com_y",
        "payload_com_z",
        "temperature",
        "base_tilt_x",
        "base_tilt_y",
    ),
    "Force": ("fx", "fy", "fz", "mx", "my", "mz"),
    "Contact": ("socket_id", "plane_id", "bar_id", "bar", "tipx", "tipy", "tipz"),
}
Choices = Mapping[str, Sequence[tuple[str, str]]]


@dataclass(frozen=True)
class Assignment:
    """A column of the file and what it is: ``target`` as `q1` or `x`, empty: not used. ``rest``: sign, scale, offset."""

    source: str
    target: str = ""
    unit: str = ""
    units: tuple[str, ...] = ()
    rest: tuple[tuple[str, Any], ...] = ()


def choices(kinds: Sequence[str]) -> Choices:
    """Return what a column may be, for a robot with joints of these kinds: the name and what it means."""
    out: dict[str, list[tuple[str, str]]] = {}
    for stem, what in OF_JOINTS.items():
        out[f"Joints: {what}"] = [(f"{stem}{k}", f"{stem}{k}") for k in range(1, len(kinds) + 1)]
    for group, names in OF_ROWS.items():
        out[group] = [(name, name) for name in names]
    out["Markers"] = [(f"m{k}{axis}", f"m{k}{axis}") for k in range(1, MARKERS + 1) for axis in "xyz"]
    return out


def contract_name(target: str, kinds: Sequence[str]) -> str:
    """Return the column of the contract that a target becomes: `q1` becomes `q1_deg`, of a prismatic joint `q1_mm`."""
    stem, number = NUMBER.sub("", target), NUMBER.search(target)
    if stem in JOINT_UNITS and number is not None:
        place = int(number[0]) - 1
        units = JOINT_UNITS[stem][place < len(kinds) and kinds[place] == "prismatic"]
    elif target in PLAIN_UNITS:
        units = PLAIN_UNITS[target]
    else:
        units = TILT_UNITS if stem.startswith("tilt") else {"mm": 1.0}
    return f"{target}_{next(iter(units))}".rstrip("_")


def parse_map(text: str) -> dict[str, Any]:
    """Read the TOML of a map.

    Raises:
        ServiceError: it is none.

    """
    try:
        return tomllib.loads(BARE_PATTERN.sub(r'\1"\2"\3', text))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ServiceError(f"The column map is not TOML: {error}.", code="payload_invalid") from error


def assignments(text: str, source: Sequence[Mapping[str, Any]], kinds: Sequence[str]) -> list[Assignment]:
    """Return what each column of the file is by a map; patterns are written out."""
    names = [str(column["name"]) for column in source]
    found: dict[str, Assignment] = {}
    for target, entry in _entries(parse_map(text)):
        for name, one in _match_columns(target, entry, names):
            found.setdefault(name, _build_assignment(name, one, entry, kinds))
    stated = {str(column["name"]): column.get("unit") for column in source}
    return [found.get(name) or Assignment(name, "", str(stated[name] or "")) for name in names]


def _entries(document: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    columns = document.get("columns")
    columns = columns if isinstance(columns, dict) else {}
    return [(target, entry) for target, entry in columns.items() if isinstance(entry, dict)]


def _match_columns(target: str, entry: Mapping[str, Any], names: Sequence[str]) -> list[tuple[str, str]]:
    """Columns of the file that an entry takes, each with what it becomes."""
    source = entry.get("from")
    if source is None or source == UNKNOWN:
        return []
    if "*" not in target or not isinstance(source, str) or "*" not in source:
        return [(str(source), target)] if str(source) in names else []
    before, _, after = source.partition("*")
    shape = re.compile(re.escape(before) + r"0*(\d{1,3})" + re.escape(after))
    numbered = sorted((int(match[1]), name) for name in names if (match := shape.fullmatch(name)))
    return [(name, target.replace("*", str(k))) for k, (_, name) in enumerate(numbered, 1)]


def _build_assignment(name: str, target: str, entry: Mapping[str, Any], kinds: Sequence[str]) -> Assignment:
    stem = target if target in PLAIN_UNITS else target.partition("_")[0]
    for plain in PLAIN_UNITS:
        if target.startswith(f"{plain}_") and len(plain) > len(stem):
            stem = plain
    unit = str(entry.get("unit") or column_unit(target) or "")
    place = int(found[0]) - 1 if (found := NUMBER.search(stem)) else 0
    rest = tuple((key, _nth(entry[key], place)) for key in ("sign", "scale", "offset", "still_below") if key in entry)
    return Assignment(name, stem, "" if unit == UNKNOWN else unit, units_for(stem, kinds), rest)


def _nth(value: Any, place: int) -> Any:
    if isinstance(value, list):
        return value[place] if place < len(value) else value[-1]
    return value


def units_for(target: str, kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the units that the file may have a target in."""
    wanted = column_unit(contract_name(target, kinds))
    if not wanted:
        return ()
    return (*units_like(wanted), TIMESTAMP) if target == "t" else units_like(wanted)


def update_map_columns(
    text: str, wanted: Sequence[Assignment], keys: Mapping[str, str | int], kinds: Sequence[str]
) -> str:
    """Return the map with these columns instead of its own; everything else in it stays.

    Raises:
        ServiceError: two columns are the same thing, or one is something that there is not.

    """
    document = parse_map(text)
    known = {name for group in choices(kinds).values() for name, _ in group}
    columns = {target: entry for target, entry in _entries(document) if "value" in entry}
    for one in wanted:
        if not one.target:
            continue
        if one.target not in known:
            raise ServiceError(f"{one.target[:40]!r} is not a column of Kilter.", code="payload_invalid")
        name = contract_name(one.target, kinds)
        if name in columns:
            raise ServiceError(
                f"Two columns of the file are said to be {one.target}: leave one of them unused.",
                code="payload_invalid",
            )
        columns[name] = {"from": keys[one.source], **_unit(one, name), **dict(one.rest)}
    return written({**document, "columns": columns})


def _unit(one: Assignment, name: str) -> dict[str, str]:
    wanted = column_unit(name)
    if not wanted:
        return {}
    fits = one.unit == TIMESTAMP or (one.unit and converter(one.unit, wanted) is not None)
    return {"unit": one.unit if fits else wanted}


def written(document: Mapping[str, Any]) -> str:
    """Write a map as TOML."""
    lines: list[str] = []
    _table(lines, "", document)
    return "\n".join(lines) + "\n"


def _table(lines: list[str], place: str, table: Mapping[str, Any]) -> None:
    plain = {key: value for key, value in table.items() if not _is_section(place, value)}
    if place and (plain or not table):
        lines += ["", f"[{place}]"]
    lines += [f"{_key(key)} = {_value(value)}" for key, value in plain.items()]
    for key, value in table.items():
        if key not in plain:
            _table(lines, f"{place}.{_key(key)}".lstrip("."), value)


def _is_section(place: str, value: Any) -> bool:
    return isinstance(value, Mapping) and not place.endswith("columns")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(part)}" for key, part in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(_value(part) for part in value)}]"
    return _text(value) if isinstance(value, str) else repr(value)
