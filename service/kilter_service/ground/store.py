"""Campaigns, versions and jobs by prefix, name or `latest`; whose a name is; what cites a campaign; tombstones.

Jobs that have ended: counts by kind, state and how long they took, and what the newest search in torques found.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, Literal, NamedTuple

from sqlalchemy import ColumnElement, Select, and_, literal, or_, select

from kilter_service.contract.wording import Kind, Tombstone
from kilter_service.ground.caller import allowed_robots, may_see
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import CampaignRow, EndedJobsRow, JobRow, RobotRow, TombstoneRow, VersionRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields, name_unnamed_job
from kilter_service.ground.paging import Page

Whose = Literal["campaign", "version", "robot"]
Table = type[CampaignRow] | type[VersionRow] | type[JobRow]
TABLES: Mapping[Kind, Table] = {"campaign": CampaignRow, "version": VersionRow, "job": JobRow}
PREFIXES: Mapping[Kind, str] = {"campaign": "cmp_", "version": "ver_", "job": "job_"}
KEPT: Mapping[Whose, type[Any]] = {"campaign": CampaignRow, "version": VersionRow, "robot": RobotRow}
LATEST = "latest"
UNNAMED = re.compile(r", (\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)$")
NUMBERED = re.compile(r"(?:(?P<robot>.+) )?v(?P<number>[1-9][0-9]{0,8})")
NOMINAL = "nominal"  # of versions: the nominal robot, which a comparison may name


class Found(NamedTuple):
    """Something that has an id: whose it is, what it is called, whether it is in use."""

    id: str
    robot: str
    name: str
    created_at: datetime
    in_use: bool
    number: int


def find_by_number(session: Session, robot_id: int | None, text: str) -> list[Found]:
    """Return the version that `tour v2` names, or `v2` where its robot is known; of each robot where it is not."""
    parts = NUMBERED.fullmatch(text)
    if parts is None:
        return []
    query = _select_references("version", robot_id).where(VersionRow.number == int(parts["number"]))
    return _fetch_references(session, query.where(RobotRow.name == parts["robot"]) if parts["robot"] else query)


def version_id(session: Session, text: str) -> str:
    """Return the id of the version that `tour v2` names; any other text as it is, which may be an id."""
    named = find_by_number(session, None, text) if " " in text else []
    return named[0].id if named else text


def find_by_id_prefix(session: Session, kind: Kind, robot_id: int | None, text: str) -> list[Found]:
    """Return what has an id that begins with ``text``, with or without what ids of the kind begin with, newest first."""
    table, prefix = TABLES[kind], PREFIXES[kind]
    whole = text if text.startswith(prefix) else prefix + text
    return _fetch_references(
        session, _select_references(kind, robot_id).where(table.id.startswith(whole, autoescape=True))
    )


def find_by_name(session: Session, kind: Kind, robot_id: int | None, name: str) -> list[Found]:
    """Return what has a name, newest first; a job of an earlier release that has none also by what it is called."""
    if not name:
        return []
    query, table = _select_references(kind, robot_id), TABLES[kind]
    if (found := _fetch_references(session, query.where(table.name == name))) or kind != "job":
        return found
    if (when := UNNAMED.search(name)) is None:
        return []
    at = datetime.fromisoformat(f"{when[1]}+00:00")
    within = and_(table.name == "", table.created_at >= at, table.created_at < at + timedelta(seconds=1))
    return [one for one in _fetch_references(session, query.where(within)) if one.name == name]


def newest(session: Session, kind: Kind, robot_id: int | None, most: int = 1) -> list[Found]:
    """Return the newest that are not retired, of jobs also those that failed; of each robot where none is given."""
    if robot_id is not None:
        query = _select_references(kind, robot_id).limit(most)
        return _fetch_references(session, query if kind == "job" else query.where(_in_use(kind)))
    everywhere = session.execute(select(RobotRow.id).where(RobotRow.retired_at.is_(None))).scalars().all()
    return [found for one in everywhere for found in newest(session, kind, one, most)]


def _select_references(kind: Kind, robot_id: int | None) -> Select[str, str, str, datetime, bool, int, str]:
    table = TABLES[kind]
    number = VersionRow.number if kind == "version" else literal(0)
    query = select(
        table.id,
        RobotRow.name.label("robot"),
        table.name,
        table.created_at,
        _in_use(kind).label("in_use"),
        number.label("number"),
        (JobRow.kind if kind == "job" else literal("")).label("kind"),
    )
    query = query.join(RobotRow, RobotRow.id == table.robot_id)
    if kind == "campaign":
        query = query.where(CampaignRow.staged.is_(False))
    if (visible := allowed_robots()) is not None:
        query = query.where(RobotRow.name.in_(visible))
    if robot_id is not None:
        query = query.where(table.robot_id == robot_id)
    return query.order_by(table.created_at.desc(), table.id)


def _in_use(kind: Kind) -> ColumnElement[bool]:
    if kind == "campaign":
        return and_(CampaignRow.retired_at.is_(None), CampaignRow.staged.is_(False))
    if kind == "version":
        return VersionRow.retired_at.is_(None)
    return JobRow.state.not_in(("failed", "cancelled"))


def _fetch_references(session: Session, query: Select[str, str, str, datetime, bool, int, str]) -> list[Found]:
    return [
        Found(key, robot, name or (name_unnamed_job(kind, robot, at) if kind else ""), at, in_use, number)
        for key, robot, name, at, in_use, number, kind in session.execute(query)
    ]


def check_name(session: Session, kind: Kind, robot_id: int, name: str, own_id: str | None = None) -> None:
    """Refuse a name that another of the robot has, or that would be taken for an id.

    Raises:
        ServiceError: it looks like an id, or is taken.

    """
    check_form(kind, name)
    others = [one for one in find_by_name(session, kind, robot_id, name) if one.in_use and one.id != own_id]
    if others:
        remedy = f", add to that one with --campaign {others[0].id}" if kind == "campaign" else ""
        retire = "" if kind == "job" else f", or retire that one (kilter {COMMANDS[kind]} retire {others[0].id})"
        raise ServiceError(
            f"Robot {others[0].robot!r} has a {kind} called {name!r} already, {others[0].id}: give another name"
            f"{remedy}{retire}.",
            code="name_taken",
            name=name,
            id=others[0].id,
        )


def check_form(kind: Kind, name: str) -> None:
    """Refuse a name that would be taken for an id.

    Raises:
        ServiceError: it looks like an id.

    """
    reserved = (LATEST,) if kind == "campaign" else (LATEST, NOMINAL)  # a job names the version that it makes
    number = NUMBERED.fullmatch(name)
    is_number = kind == "version" and number is not None and number["robot"] is None
    if (
        name.strip() in reserved
        or name.strip().startswith(tuple(PREFIXES.values()))
        or name != name.strip()
        or is_number
    ):
        what = "begins or ends with a space" if name != name.strip() else "looks like an id"
        what = "is the number of one" if is_number else what
        words = " or ".join(map(repr, reserved))
        raise ServiceError(
            f"The name {name!r} of a {kind} {what}: give one that is not {words}, does not begin with "
            f"{', '.join(PREFIXES.values())}, and has no space around it.",
            code="name_invalid",
            name=name,
        )


def free_name(session: Session, kind: Kind, robot_id: int, name: str) -> str:
    """Return a name, with a number behind it where another of the robot has it."""
    tried, number = name, 1
    while any(one.in_use for one in find_by_name(session, kind, robot_id, tried)):
        number += 1
        tried = f"{name[:190]} ({number})"
    return tried


def change(
    session: Session, kind: Literal["campaign", "version"], id_: str, name: str | None, notes: str | None
) -> None:
    """Write the name and the notes that people give something; None leaves them as they are."""
    row = session.get_one(KEPT[kind], id_)
    row.name, row.notes = row.name if name is None else name, row.notes if notes is None else notes
    session.flush()


def retire(session: Session, whose: Whose, key: str | int, actor: str) -> None:
    """Take something out of use; nothing changes when it already is."""
    row = session.get_one(KEPT[whose], key)
    if row.retired_at is None:
        row.retired_at, row.retired_by = utc_now(), actor
        session.flush()


def restore(session: Session, whose: Whose, key: str | int) -> None:
    """Bring something back into use; nothing changes when it already is.

    Raises:
        ServiceError: another one has its name now.

    """
    row = session.get_one(KEPT[whose], key)
    if row.retired_at is None:
        return
    if whose != "robot":  # no two robots have one name, in use or not
        check_name(session, whose, row.robot_id, row.name, row.id)
    row.retired_at, row.retired_by = None, ""
    session.flush()


def citing_campaign(session: Session, robot_id: int, campaign_id: str) -> list[str]:
    """Return the versions that were made from a campaign."""
    rows = session.execute(select(VersionRow.id, VersionRow.campaigns).where(VersionRow.robot_id == robot_id))
    return [version for version, campaigns in rows if any(used["id"] == campaign_id for used in campaigns)]


def add_tombstone(session: Session, left: Tombstone) -> None:
    """Keep what is left of something that is purged."""
    session.add(TombstoneRow(**left.model_dump()))


def tombstones(session: Session, robot: str | None, page: Page) -> list[Tombstone]:
    """Return what was purged, newest first, one more than the page shows."""
    row = TombstoneRow
    query = select(row).order_by(row.at.desc(), row.id)
    if robot is not None:
        query = query.where(row.robot == robot)
    if (visible := allowed_robots()) is not None:
        query = query.where(row.robot.in_(visible))
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(or_(row.at < moment, and_(row.at == moment, row.id > key)))
    return [copy_fields(Tombstone, found) for found in session.execute(query.limit(page.fetch_limit)).scalars()]


def find_tombstone(session: Session, kind: str, id_: str) -> Tombstone | None:
    """Return what is left of something that was purged, if it was."""
    query = select(TombstoneRow).where(TombstoneRow.kind == kind, TombstoneRow.id == id_)
    row = session.execute(query.order_by(TombstoneRow.at.desc()).limit(1)).scalar_one_or_none()
    return None if row is None else copy_fields(Tombstone, row)


def gone(session: Session, kind: str, id_: str) -> str:
    """Say that something was purged, if it was; empty else."""
    found = find_tombstone(session, kind, id_)
    if found is None or not may_see(found.robot):
        return ""
    return f" It was purged by {found.by} on {found.at:%Y-%m-%d %H:%M} UTC (sha256 {found.sha256[:12]})."


def refuse_cited(kind: Kind, id_: str, citing: Sequence[str], remedy: str) -> None:
    """Refuse to purge what something else cites."""
    if citing:
        raise ServiceError(
            f"{kind.capitalize()} {id_} is cited by {', '.join(citing[:10])}{' and more' if len(citing) > 10 else ''}: "
            f"{remedy}, or retire it instead (kilter {COMMANDS[kind]} retire {id_}).",
            code="cited",
            cited_by=list(citing),
            **{kind: id_},
        )


# The command that lists, names and retires what there is of a kind.
COMMANDS = {"robot": "robot", "campaign": "measure campaigns", "version": "version"}


def refuse_retired(kind: str, id_: str, retired_at: datetime | None) -> None:
    """Refuse to work with what is retired.

    Raises:
        ServiceError: it is.

    """
    if retired_at is not None:
        raise ServiceError(
            f"{kind.capitalize()} {id_} is retired since {retired_at:%Y-%m-%d}: take another, or bring it back with "
            f"`kilter {COMMANDS[kind]} restore {id_}`.",
            code="retired",
            kind=kind,
            id=id_,
        )


# Counted are jobs up to each, and no longer than it; the bins may change with a release, what was counted keeps its own.
AT_MOST_MS = (250, 1000, 2500, 5000, 10_000, 30_000, 60_000, 120_000, 300_000, 600_000, 1_800_000, 3_600_000)
LONGER_MS = 2**31 - 1
NEVER_RAN = 0


def count(session: Session, row: JobRow) -> None:
    """Count a job that has just ended, in the transaction that ends it."""
    took = _took(row)
    key = (row.kind, row.state, NEVER_RAN if took is None else _duration_bin(took))
    counted = session.get(EndedJobsRow, key)
    if counted is None:
        counted = EndedJobsRow(kind=row.kind, state=row.state, at_most_ms=key[2], jobs=0, seconds=0.0)
        session.add(counted)
    counted.jobs += 1
    counted.seconds += 0.0 if took is None else took.total_seconds()


def _took(row: JobRow) -> timedelta | None:
    if row.started_at is None or row.finished_at is None:
        return None
    return max(timedelta(0), row.finished_at - row.started_at)  # the clock may have been set back


def _duration_bin(took: timedelta) -> int:
    at = bisect_left(AT_MOST_MS, took / timedelta(milliseconds=1))
    return AT_MOST_MS[at] if at < len(AT_MOST_MS) else LONGER_MS


def list_searches_in_torques(session: Session, robot_id: int, limit: int) -> list[tuple[str, str]]:
    """Return id and name of the newest searches in torques of a robot that have a model, the newest first."""
    found = session.execute(_searches_in_torques(robot_id).limit(limit))
    return [(job_id, name) for job_id, name, _ in found]


def _searches_in_torques(robot_id: int) -> Select[tuple[str, str, Any]]:
    row = JobRow
    model = row.result["motion"]["model"]
    return (
        select(row.id, row.name, model)
        .where(
            row.robot_id == robot_id,
            row.kind.in_(("gap", "identify")),
            row.state == "succeeded",
            model["base"].as_string().is_not(None),
        )
        .order_by(row.created_at.desc(), row.id)
    )


def get_search_in_torques(
    session: Session, robot_id: int, job_id: str | None = None
) -> tuple[str, str, dict[str, Any]]:
    """Return id, name and model of the newest search in torques of a robot, or of the one that is named.

    Raises:
        ServiceError: ``no_torque_model``: there is none.

    """
    query = _searches_in_torques(robot_id)
    if job_id is not None:
        query = query.where(JobRow.id == job_id)
    found = session.execute(query.limit(1)).one_or_none()
    if found is None:
        raise ServiceError(
            f"No search in torques of this robot has a model{'' if job_id is None else f' by the id {job_id!r}'}: upload a log "
            "with t_s and tau1_nm ..., and search it (kilter gap).",
            code="no_torque_model",
        )
    return found[0], found[1], found[2]
