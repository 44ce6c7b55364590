"""What is stored about today: evaluations, campaigns and what versions were fitted to, of many robots in a few queries."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from sqlalchemy import func, select

from kilter_service.campaigns import keeping
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import ActivationRow, CampaignRow, JobRow, UploadRow, VersionRow
from kilter_service.versions.store import REZEROED

ALARMS = ("moved", "cannot_tell")  # verdicts of a check


@dataclass(frozen=True)
class Measured:
    """A campaign in use with rows: the hashes of its files, and when it was measured; not ``stated``: when they came.

    ``views``: its rows are corners in pictures.
    """

    id: str
    name: str
    measured_at: datetime
    stated: bool
    hashes: frozenset[str]
    whole: str | None = None  # the campaign in use that it is the rest of
    role: str = "train"
    views: bool = False


@dataclass(frozen=True)
class Active:
    """The version a robot is corrected with: its report's parts that count here, and what its line was fitted to."""

    id: str
    job_id: str
    created_at: datetime
    campaigns: list[dict[str, Any]]
    metrics: Mapping[str, Any]
    effects: list[dict[str, Any]]
    fitted: frozenset[str]


@dataclass(frozen=True)
class Evaluated:
    """An evaluation of a version, or a check against it (``kind``): errors by campaign, and the frames that were refitted."""

    kind: str
    job_id: str
    at: datetime
    version_id: str
    metrics: Mapping[str, Any]
    refit: list[str]
    agrees: bool = False  # of a check: what the version does not know of itself, and the noise, explain the errors
    said: str | None = None  # of a check that alarmed, its verdict in words


@dataclass(frozen=True)
class Made:
    """A version in use; ``rows`` is the campaign of the check by which it was re-zeroed, None of any other."""

    id: str
    name: str
    parent: str | None
    rows: str | None
    was_active: bool


@dataclass(frozen=True)
class Searched:
    """A gap search that was completed."""

    job_id: str
    at: datetime
    campaigns: list[str]
    result: Mapping[str, Any]


def active(session: Session, of: Collection[int]) -> dict[int, Active]:
    """Return the active versions, by robot."""
    last = select(func.max(ActivationRow.id)).where(ActivationRow.robot_id.in_(of)).group_by(ActivationRow.robot_id)
    row = VersionRow
    columns = (
        row.robot_id,
        row.id,
        row.job_id,
        row.created_at,
        row.campaigns,
        row.report["metrics"],
        row.calibration["effects"],
    )
    query = select(*columns).join(ActivationRow, ActivationRow.version_id == row.id).where(ActivationRow.id.in_(last))
    line = _lines(session, of)
    return {
        robot: Active(key, job, at, used, metrics or {}, effects or [], _training_file_hashes(line, key))
        for robot, key, job, at, used, metrics, effects in session.execute(query)
    }


def _lines(session: Session, of: Collection[int]) -> dict[str, tuple[str | None, list[dict[str, Any]]]]:
    query = select(VersionRow.id, VersionRow.parent_id, VersionRow.campaigns).where(VersionRow.robot_id.in_(of))
    return {key: (parent, used) for key, parent, used in session.execute(query)}


def _training_file_hashes(lines: Mapping[str, tuple[str | None, list[dict[str, Any]]]], version: str) -> frozenset[str]:
    """Hashes of the files that a version, or one that it continues, was fitted to."""
    found: set[str] = set()
    following: str | None = version
    while following is not None and following in lines:
        following, used = lines[following]
        found.update(sha256 for one in used if one["use"] == "train" for sha256 in one["sha256"])
    return frozenset(found)


def measured_campaigns(session: Session, of: Collection[int]) -> dict[int, dict[str, Measured]]:
    """Return the campaigns in use that have rows, by robot and id."""
    row = CampaignRow
    begins = func.substr(row.notes, 1, keeping.READ)
    query = (
        select(
            row.robot_id,
            row.id,
            row.name,
            row.measured_at,
            row.retired_at,
            row.role,
            begins,
            row.conditions["cameras"],
            UploadRow.sha256,
            UploadRow.created_at,
        )
        .join(UploadRow, UploadRow.campaign_id == row.id)
        .where(row.robot_id.in_(of), row.staged.is_(False))
    )
    retired: set[str] = set()
    out: dict[int, dict[str, Measured]] = {}
    for robot, key, name, stated, ended, role, notes, cameras, sha256, sent in session.execute(query):
        at, whole = stated or sent, keeping.parse_origin_campaign(notes)
        retired |= {key} if ended is not None else set()
        known = out.setdefault(robot, {}).get(
            key, Measured(key, name, at, stated is not None, frozenset(), whole, role, bool(cameras))
        )
        out[robot][key] = replace(known, measured_at=max(known.measured_at, at), hashes=known.hashes | {sha256})
    return {robot: _together(found, retired) for robot, found in out.items()}


def _together(found: Mapping[str, Measured], retired: Collection[str]) -> dict[str, Measured]:
    """Campaigns in use. What is left of one was measured when the whole one was, and rows of either are rows of the other."""
    out = dict(found)
    for key, one in found.items():
        whole = found.get(one.whole or "")
        told = None if whole is None or whole.id in retired else whole.id
        out[key] = replace(out[key], whole=told)
        if whole is not None:
            out[key] = replace(out[key], measured_at=whole.measured_at, hashes=out[key].hashes | whole.hashes)
            out[whole.id] = replace(out[whole.id], hashes=out[whole.id].hashes | one.hashes)
    return {key: one for key, one in out.items() if key not in retired}


def evaluations(session: Session, of: Collection[str]) -> dict[str, list[Evaluated]]:
    """Return the evaluations and checks of versions that gave errors, oldest first; the rows in them stay unread."""
    row = JobRow
    version = row.result["version_id"].as_string()
    query = (
        select(
            row.kind,
            row.id,
            row.finished_at,
            version,
            row.result["metrics"],
            row.result["refit"],
            row.result["verdict"],
            row.result["sentence"],
        )
        .where(row.kind.in_(("evaluate", "drift")), row.state == "succeeded", version.in_(of))
        .order_by(row.created_at, row.id)
    )
    out: dict[str, list[Evaluated]] = {}
    for kind, key, at, evaluated, metrics, refit, verdict, sentence in session.execute(query):
        if metrics:
            said = sentence if verdict in ALARMS else None
            one = Evaluated(kind, key, at, evaluated, metrics, refit or [], verdict == "ok", said)
            out.setdefault(evaluated, []).append(one)
    return out


def versions(session: Session, of: Collection[int]) -> dict[int, list[Made]]:
    """Return the versions in use, by robot, oldest first."""
    row = VersionRow
    campaign = row.report[REZEROED]["campaign"].as_string()
    used = select(ActivationRow.id).where(ActivationRow.version_id == row.id).exists()
    query = (
        select(row.robot_id, row.id, row.name, row.number, row.parent_id, campaign, used)
        .where(row.robot_id.in_(of), row.retired_at.is_(None))
        .order_by(row.created_at, row.id)
    )
    out: dict[int, list[Made]] = {}
    for key, version, name, number, parent, rows, was_active in session.execute(query):
        out.setdefault(key, []).append(Made(version, name or f"v{number}", parent, rows, was_active))
    return out


def causes(session: Session, checks: Collection[str]) -> dict[str, list[str]]:
    """Return the names of the causes that checks may have, by job."""
    query = select(JobRow.id, JobRow.result["causes"]).where(JobRow.id.in_(checks))
    return {job: [str(one["name"]) for one in found or []] for job, found in session.execute(query)}


def planned(session: Session, of: Collection[int]) -> dict[int, tuple[str, int]]:
    """Return the job of each robot that planned poses after the last rows came, and how many these are."""
    row = JobRow
    rows_came = (
        select(CampaignRow.robot_id, func.max(UploadRow.created_at).label("at"))
        .join(UploadRow, UploadRow.campaign_id == CampaignRow.id)
        .group_by(CampaignRow.robot_id)
        .subquery()
    )
    query = (
        select(row.robot_id, row.id, row.result["count"])
        .join(rows_came, rows_came.c.robot_id == row.robot_id, isouter=True)
        .where(row.robot_id.in_(of), row.kind == "plan", row.state == "succeeded")
        .where((rows_came.c.at.is_(None)) | (row.created_at > rows_came.c.at))
        .order_by(row.created_at, row.id)
    )
    return {robot: (job, int(count)) for robot, job, count in session.execute(query) if count}


def proposed(session: Session, of: Collection[int]) -> dict[int, tuple[str, int]]:
    """Return the newest gap search of each robot that proposes poses, and how many."""
    row = JobRow
    newest = func.row_number().over(partition_by=row.robot_id, order_by=(row.created_at.desc(), row.id))
    ranked = select(row.id, newest.label("place")).where(
        row.robot_id.in_(of), row.kind == "gap", row.state == "succeeded"
    )
    last = ranked.subquery()
    query = (
        select(row.robot_id, row.id, row.result["next_poses"]).join(last, last.c.id == row.id).where(last.c.place == 1)
    )
    return {robot: (job, len(poses)) for robot, job, poses in session.execute(query) if poses}


def searching(session: Session, of: Collection[int]) -> dict[int, str]:
    """Return the newest job of each robot that identifies or searches now, or waits to."""
    row = JobRow
    query = select(row.robot_id, row.id).where(
        row.robot_id.in_(of), row.kind.in_(("gap", "identify")), row.state.in_(("queued", "running"))
    )
    return {robot: job for robot, job in session.execute(query.order_by(row.created_at, row.id)) if robot is not None}


def newest_search(session: Session, robot_id: int) -> Searched | None:
    """Return the newest gap search of a robot that was completed, however many jobs came after it."""
    query = (
        select(JobRow)
        .where(JobRow.robot_id == robot_id, JobRow.kind == "gap", JobRow.state == "succeeded")
        .order_by(JobRow.created_at.desc(), JobRow.id)
        .limit(1)
    )
    row = session.execute(query).scalar_one_or_none()
    if row is None or row.result is None or row.finished_at is None:
        return None
    return Searched(row.id, row.finished_at, list(row.request.get("campaigns", [])), row.result)
