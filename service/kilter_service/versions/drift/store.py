"""Rows of checks: the jobs that made them, which are kept."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy import func, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import (
    ActivationRow,
    CampaignRow,
    CreepingRow,
    JobRow,
    RobotRow,
    UploadRow,
    VersionRow,
)
from kilter_service.robots import store as robots
from kilter_service.versions.drift.wire import Activated, StoredCheck
from kilter_service.versions.store import REZEROED

MOST = 1000  # checks of a robot, the newest
READ = ("verdict", "version_id", "sentence", "p_value", "temperature_c", "new_setup", "joint_log", "unseen")
NUMBERS = ("looked_at", "noise_mm", "poses")
MOST_LOOKED = 30  # looked through for the last one, and the last that agreed

Digests = frozenset[str]  # of the uploads of a campaign


def checks(session: Session, of: Collection[int], most: int = MOST) -> dict[int, list[StoredCheck]]:
    """Return the newest checks by robot, by when their rows were measured: a clock that was set back changes no order of jobs.

    Those of campaigns that were retired are left out. Of their results, which are long, what all of them are read for;
    ``with_numbers`` adds what is summed.
    """
    row = JobRow
    place = func.row_number().over(partition_by=row.robot_id, order_by=(row.created_at.desc(), row.id))
    newest = (
        select(row.id, place.label("place"))
        .where(row.robot_id.in_(of), row.kind == "drift", row.state == "succeeded")
        .subquery()
    )
    query = (
        select(row.robot_id, row.id, row.request["campaigns"], *(row.result[name] for name in READ))
        .join(newest, newest.c.id == row.id)
        .where(newest.c.place <= most)
        .order_by(row.created_at, row.id)
    )
    found = [
        (robot, job, campaigns[0], dict(zip(READ, result, strict=True)))
        for robot, job, campaigns, *result in session.execute(query)
        if result[0] is not None
    ]
    at, digests = measurement_times_and_digests(session, {campaign for _, _, campaign, _ in found})
    out: dict[int, list[StoredCheck]] = {}
    for robot, job, campaign, result in found:
        if campaign in at:
            one = StoredCheck(job, campaign, at[campaign], result, of_all_causes(result))
            out.setdefault(robot, []).append(one)
    return {robot: _newest_of_each(made, digests) for robot, made in out.items()}


def with_numbers(session: Session, made: Sequence[StoredCheck]) -> list[StoredCheck]:
    """Return checks with the numbers of their causes, and how well their rows were measured."""
    row = JobRow
    query = select(row.id, *(row.result[name] for name in NUMBERS)).where(row.id.in_([one.job_id for one in made]))
    more = {job: dict(zip(NUMBERS, values, strict=True)) for job, *values in session.execute(query)}
    return [replace(one, result={**one.result, **more[one.job_id]}) for one in made]


def of_version(session: Session, robot: int, version: str, besides: Collection[str]) -> list[StoredCheck]:
    """Return the newest checks of a robot against a version that looked at every cause, but for those of some campaigns."""
    found = checks(session, [robot], MOST_LOOKED).get(robot, [])
    own = [one for one in found if one.whole and one.result.get("version_id") == version]
    return with_numbers(session, [one for one in own if one.campaign_id not in besides])


def _newest_of_each(made: list[StoredCheck], digests: Mapping[str, Digests]) -> list[StoredCheck]:
    """Of several checks of the same rows against a version the last, however often these were sent; by when measured."""
    newest = {(digests[one.campaign_id], one.result.get("version_id")): one for one in made}
    return sorted(newest.values(), key=lambda one: one.at)


def measurement_times_and_digests(
    session: Session, campaigns: Collection[str]
) -> tuple[dict[str, datetime], dict[str, Digests]]:
    """When campaigns in use were measured, or the last of their rows came; and what tells the same rows sent twice."""
    row = CampaignRow
    query = (
        select(row.id, row.measured_at, UploadRow.created_at, UploadRow.sha256)
        .join(UploadRow, UploadRow.campaign_id == row.id)
        .where(row.id.in_(campaigns), row.retired_at.is_(None))
    )
    at: dict[str, datetime] = {}
    digests: dict[str, Digests] = {}
    for key, stated, came, sha256 in session.execute(query):
        at[key] = stated or max(came, at.get(key, came))
        digests[key] = digests.get(key, frozenset()) | {sha256}
    return at, digests


def activations(session: Session, of: Collection[int]) -> dict[int, list[Activated]]:
    """Return the logs of active versions, oldest first, by robot."""
    row = ActivationRow
    rezeroed = VersionRow.report[REZEROED]["campaign"].as_string()
    query = (
        select(row.robot_id, row.version_id, row.at, row.action, rezeroed)
        .join(VersionRow, VersionRow.id == row.version_id)
        .where(row.robot_id.in_(of))
        .order_by(row.id)
    )
    out: dict[int, list[Activated]] = {}
    for robot, version, at, action, campaign in session.execute(query):
        out.setdefault(robot, []).append(Activated(version, at, action, campaign is not None))
    return out


def told_creeping(session: Session) -> list[str]:
    """Return the robots that the operator's address was told to be creeping, by name."""
    query = select(RobotRow.name).join(CreepingRow, CreepingRow.robot_id == RobotRow.id).order_by(RobotRow.name)
    return list(session.execute(query).scalars())


def note_creeping(session: Session, robot: str, job: str) -> bool:
    """Note that it is told that a robot creeps since a check; False: that was told already."""
    key = robots.get(session, robot).id
    if session.get(CreepingRow, key) is not None:
        return False
    session.add(CreepingRow(robot_id=key, job_id=job))
    return True


def forget_creeping(session: Session, robot: str) -> str | None:
    """Note that it is told that a robot no longer creeps; returns the check since which it did, None where none was told."""
    row = session.get(CreepingRow, robots.get(session, robot).id)
    if row is None:
        return None
    session.delete(row)
    return str(row.job_id)


def of_all_causes(result: dict[str, Any]) -> bool:
    """Whether nothing was fitted first, and places were measured: a joint log alone has other numbers to sum.

    What an earlier release stored of such a log shows only by the base, which no log sees.
    """
    joint_log = result.get("joint_log")
    if joint_log is None:
        joint_log = "base" in (result.get("unseen") or [])
    return not result.get("new_setup") and not joint_log
