"""What the view of a dropped file does: reading it anew with another map, and storing it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_files.formats.reader import DEVICE
from kilter_files.formats.registry import readers_for
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign, NewCampaign, Parts
from kilter_service.contract.jobs.plan import PLAN
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.page.drop.column_map import (
    Assignment,
    assignments,
    choices,
    parse_map,
    units_for,
    update_map_columns,
)
from kilter_service.page.drop.drafts import Draft
from kilter_service.page.shared import proposing
from kilter_service.robots import service as robots

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
    job = proposing.get_proposing_job(database, draft.robot, draft.job)
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
        "units_for": lambda target: units_for(target, kinds),
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
            told = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors()[:5])
            raise ServiceError(f"The campaign cannot be stored so: {told}.", code="payload_invalid") from error
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
