"""What the view of a dropped file does: reading it anew with another map, and storing it."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_files.formats import DEVICE, readers_for
from kilter_files.ground import TIMESTAMP, UNKNOWN, column_unit, converter, units_like
from kilter_files.maps import BARE_PATTERN
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign, NewCampaign, Parts
from kilter_service.contract.columns import JOINT_UNITS, PLAIN_UNITS, TILT_UNITS
from kilter_service.contract.jobs.plan import PLAN
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.page.drop.drafts import Draft
from kilter_service.page.shared import asking
from kilter_service.page.words import validation_words
from kilter_service.robots import service as robots

NUMBER = re.compile(r"\d+")
MARKERS = 4
OF_JOINTS = {
    "q": "reading",
    "link": "link-side encoder",
    "cmd": "command",
    "dir": "direction it came from",
    "qd": "speed",
    "qdd": "acceleration",
    "tau": "torque",
}
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
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(part)}" for key, part in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(_value(part) for part in value)}]"
    if isinstance(value, str | bool):  # as JSON has them, but for one character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


LONGEST_MAP = 200_000
LONGEST_NOTES = 20_000
MOST_OF_CHECK = 10  # poses of a file that is taken for a check where a version is active


def parse_measured_day(text: str) -> datetime | None:
    """Read the day of the form, as its noon in UTC; None of an empty field.

    Raises:
        ServiceError: it is not a day.

    """
    if not text.strip():
        return None
    try:
        day = date.fromisoformat(text.strip())
    except ValueError:
        raise ServiceError(f"{text[:40]!r} is not a day: give it as 2026-11-02.", code="payload_invalid") from None
    noon = datetime.combine(day, time(12), UTC)
    return min(noon, datetime.now(UTC)) if day == datetime.now(UTC).date() else noon


def joint_kinds(database: Database, robot: str) -> list[str]:
    """Return whether each joint of a robot is revolute or prismatic."""
    return [str(joint.kind) for joint in robots.get(database, robot).joints]


def meant_for(database: Database, draft: Draft) -> tuple[str, str]:
    """Return the role that the form proposes, and why where that is not the usual one: a check is fitted by nobody."""
    job = asking.get_proposing_job(database, draft.robot, draft.job)
    if job is not None and PLAN.is_kind_of(job) and job.options.purpose == "check":
        return "validation", "These poses were planned for a check: no fit takes its rows."
    if (
        draft.facts is None
        or draft.facts.repeats.poses > MOST_OF_CHECK
        or robots.get(database, draft.robot).active_version is None
    ):
        return "train", ""
    return (
        "validation",
        "So few poses beside an active version are a check, as a rule: no fit takes its rows. To fit them say identification.",
    )


def ways() -> list[tuple[str, str]]:
    """Return how a file may be read: the name, and what it means."""
    return [
        ("auto", "find out"),
        ("map", "through a column map"),
        ("views-fixed", "pictures, the camera in the room"),
        ("views-flange", "pictures, the camera on the flange"),
        *((name, reader.title) for name, reader in readers_for(DEVICE).items()),
    ]


def read_as(draft: Draft, way: str) -> None:
    """Choose how a file is read.

    Raises:
        ServiceError: there is no such way.

    """
    if way not in dict(ways()):
        raise ServiceError(f"{way[:40]!r} is not a way to read a file.", code="option_invalid")
    draft.read_as = way


def choose(
    draft: Draft, kinds: Sequence[str], columns: Sequence[str], targets: Sequence[str], units: Sequence[str]
) -> None:
    """Take the map of the form: what each column of the file is.

    Raises:
        ServiceError: the form is not of this file, or two columns are the same thing.

    """
    source = draft.understood.get("source") or []
    now = {one.source: one for one in assignments(draft.understood.get("map") or "", source, kinds)}
    if not len(columns) == len(targets) == len(units) or not set(columns) <= set(now):
        raise ServiceError("The form is not of this file: load the page anew.", code="payload_invalid")
    wanted = []
    for name, target, unit in zip(columns, targets, units, strict=True):
        before = now[name]
        stated = next((str(one.get("unit") or "") for one in source if one["name"] == name), "")
        same = before.target == target
        wanted.append(replace(before, target=target, unit=unit or stated, rest=before.rest if same else ()))
    chosen = {one.source for one in wanted}
    wanted += [one for name, one in now.items() if name not in chosen]
    keys = {str(one["name"]): one["key"] for one in source}
    _keep(draft, update_map_columns(draft.understood.get("map") or "", wanted, keys, kinds))


def write(draft: Draft, text: str) -> None:
    """Take a map as it was written.

    Raises:
        ServiceError: it is not TOML, or too long.

    """
    if len(text) > LONGEST_MAP:
        raise ServiceError(f"The column map has more than {LONGEST_MAP} characters.", code="payload_invalid")
    parse_map(text)
    _keep(draft, text.replace("\r\n", "\n"))


def _keep(draft: Draft, text: str) -> None:
    draft.map.write_text(text, encoding="utf-8")
    draft.read_as = "map"


def column_map_form(draft: Draft, kinds: Sequence[str]) -> dict[str, Any]:
    """Return what the form of the column map shows."""
    source = draft.understood.get("source") or []
    try:
        found = assignments(draft.understood.get("map") or "", source, kinds)
    except ServiceError:
        found = [Assignment(str(one["name"])) for one in source]
    return {
        "assignments": list(zip(source, found, strict=True)),
        "choices": choices(kinds),
        "turned": _orientation_columns(draft),
    }


def _orientation_columns(draft: Draft) -> set[str]:
    """Columns that the table [orientation] of the map takes together."""
    try:
        table = parse_map(draft.understood.get("map") or "").get("orientation")
    except ServiceError:
        return set()
    names = table.get("from") if isinstance(table, dict) else None
    return {str(name) for name in names} if isinstance(names, list) else set()


def conditions(**given: str) -> dict[str, float]:
    """Return the numbers that were filled in; decimal commas are read too.

    Raises:
        ServiceError: one is not a number.

    """
    out = {}
    for name, text in given.items():
        if not text.strip():
            continue
        try:
            out[name] = float(text.replace(",", "."))
        except ValueError:
            out[name] = math.nan
        if not math.isfinite(out[name]):
            raise ServiceError(
                f"{name} is {text[:40]!r}, which is not a number: write it like 2.5.", code="payload_invalid"
            )
    return out


def point(text: str) -> list[float]:
    """Read a point as ``x,y,z``.

    Raises:
        ServiceError: it is not three numbers.

    """
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3 or not all(map(math.isfinite, found)):
        raise ServiceError(f"{text[:40]!r} is not a point: write three numbers like 0,0,60.", code="payload_invalid")
    return found


def store(database: Database, draft: Draft, campaign: dict[str, object], sha256: str) -> Campaign:
    """Store what is shown as a campaign, once.

    Raises:
        ServiceError: something else is shown by now, a name that is taken, or a field that cannot be.
        CoreError: an upload of these rows would be refused.

    """
    with draft.turn:
        if draft.campaign:
            return campaigns.get(database, draft.campaign)
        content = _verify_unchanged(draft, sha256)
        try:
            new = NewCampaign.model_validate({**campaign, "staged": True})
        except ValidationError as error:
            raise ServiceError(
                f"The campaign cannot be stored so: {validation_words(error)}.", code="payload_invalid"
            ) from error
        notes = _notes_with_source(draft, new.notes)
        added = campaigns.add(database, draft.robot, new.model_copy(update={"notes": notes}))
        try:
            campaigns.upload(database, added.id, draft.rows, draft.understood["media"], content)
        except CoreError:
            campaigns.discard(database, added.id)
            raise
        stored = campaigns.commit(database, added.id, Parts(sha256=[content]))
        draft.campaign = stored.id
        return stored


def _verify_unchanged(draft: Draft, sha256: str) -> str:
    if draft.refusal or draft.facts is None:
        raise ServiceError(draft.refusal or "Nothing was understood of this file yet.", code="payload_invalid")
    content = _hash(draft.rows)
    if content != sha256 or content != draft.understood.get("sha256"):
        raise ServiceError(
            "The file was read in another way since this page was shown: load it anew, look at the rows, and store them then.",
            code="digest_mismatch",
        )
    return content


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _notes_with_source(draft: Draft, notes: str) -> str:
    """Return the notes with where the rows come from, as far as there is room."""
    said = f"File {draft.name}, SHA-256 {draft.file_sha256}, read {draft.understood.get('reader', '')}."
    text = draft.understood.get("map") or ""
    whole = f"{notes}\n\n{said}" + (
        f"\n{text}" if draft.read_as == "map" or draft.understood["reader"] == "column map" else ""
    )
    fitting = (whole.strip(), f"{notes}\n\n{said}".strip(), notes)
    return next(one for one in fitting if len(one) <= LONGEST_NOTES or one is fitting[-1])
