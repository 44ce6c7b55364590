"""Rows of versions and activations, and what they become in core.

Rows of kept answers.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.orm import InstrumentedAttribute

from kilter_service.contract.fits import Metrics
from kilter_service.contract.jobs.kind import FINAL
from kilter_service.contract.versions import CorrectionLimits, VersionSummary
from kilter_service.contract.wording import as_written
from kilter_service.ground import store as references
from kilter_service.ground.core import core_identify, core_model
from kilter_service.ground.db import Session
from kilter_service.ground.db.audited import note
from kilter_service.ground.db.tables import ActivationRow, JobRow, ReplayRow, RobotRow, VersionRow
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import ALL, Page
from kilter_service.ground.settings import code_version
from kilter_service.robots import store as robots
from kilter_service.robots.documents import hash_canonical_json
from kilter_service.versions.records import ActivationRecord, VersionRecord

if TYPE_CHECKING:
    from kilter_core.model import Calibration


@dataclass(frozen=True)
class NewVersion:
    """A version to store: core's calibration document (SI), the identification's report, covariance and origin."""

    calibration: dict[str, Any]
    report: dict[str, Any]
    covariance: dict[str, Any]
    campaigns: list[dict[str, Any]]
    limits: dict[str, Any]
    parent_id: str | None
    code_version: str
    name: str = ""


@dataclass(frozen=True)
class ActiveVersion:
    """The version a robot is corrected with, ready for core.

    ``epoch`` grows with every activation on this server; ``sha256`` is the version's, its number in the stream.
    ``limits`` are the largest correction the version may make. ``workspace`` is what its report says of poses all over
    the joint limits, None where it says nothing.
    """

    robot: str
    id: str
    sha256: str
    epoch: int
    calibration: Calibration
    limits: CorrectionLimits
    workspace: dict[str, Any] | None = None
    rules: dict[str, Any] | None = None  # task and rules that it was activated under


HELD_OUT = "held_out_fraction"  # what a job held out by itself, in the report of its version


@dataclass(frozen=True)
class Training:
    """What a version was fitted to: campaigns with the hashes of their uploads, in the order of the fit.

    ``fraction`` of the poses was held out by a job of ``kind`` with ``seed``; None when all were fitted. ``unasked`` says
    that the job held them out by its own rule. ``rounded``: poses were told apart by rounded readings then.
    ``by_content``: they were drawn from what the rows hold, not from their order. ``changed`` is how many parameters were
    re-zeroed by these rows; None where all were fitted.
    """

    kind: str
    campaigns: tuple[tuple[str, tuple[str, ...]], ...]
    fraction: float | None
    seed: int
    unasked: bool = False
    rounded: bool = False
    by_content: bool = True
    changed: int | None = None


TORQUES = "torques"  # of a calibration: what tells torques ahead; of a campaign: the log that this was found in
REZEROED = "rezeroed"  # of a report: the campaign that said what moved; rows from before it are of the arm as it was
ROBOT_HASHED = 2  # the hash scheme of new versions: calibration, limits and the robot's chain
POSES, BY_DISTANCE = "poses", "by distance"  # versions without it were split by rounded readings
SPLIT, BY_CONTENT = "split", "by content"  # versions without it were split by the order of their rows


def add(session: Session, robot_id: int, job_id: str, new: NewVersion) -> str:
    """Store the version of a job and return its id; the same job a repeat changes nothing."""
    version_id = f"ver_{job_id.removeprefix('job_')}"
    if session.get(VersionRow, version_id) is not None:
        return version_id
    chain, number = robots.by_id(session, robot_id).sha256, robots.count_version(session, robot_id)
    session.add(
        VersionRow(
            id=version_id,
            robot_id=robot_id,
            parent_id=new.parent_id,
            job_id=job_id,
            sha256=hash_canonical_json({"calibration": new.calibration, "limits": new.limits, "robot": chain}),
            hash_scheme=ROBOT_HASHED,
            name=references.free_name(session, "version", robot_id, new.name) if new.name else "",
            robot_sha256=chain,
            calibration=new.calibration,
            report={**new.report, POSES: BY_DISTANCE, SPLIT: BY_CONTENT},
            covariance=new.covariance,
            campaigns=new.campaigns,
            limits=new.limits,
            code_version=new.code_version,
            number=number,
        )
    )
    session.flush()
    return version_id


def get(session: Session, version_id: str) -> VersionRecord:
    """Return a version.

    Raises:
        ServiceError: there is none.

    """
    row = _row(session, version_id)
    return _record(row, robots.by_id(session, row.robot_id).name, active_entry(session, row.robot_id))


def _row(session: Session, version_id: str) -> VersionRow:
    return robots.visible_row(session, VersionRow, version_id, "GET /v1/robots/{robot}/versions")


def _record(row: VersionRow, robot: str, last: ActivationRecord | None) -> VersionRecord:
    return copy_fields(VersionRecord, row, robot=robot, active=last is not None and last.version_id == row.id)


def usable(session: Session, version_id: str) -> VersionRecord:
    """Return a version that is in use.

    Raises:
        ServiceError: there is none, or it is retired.

    """
    found = get(session, version_id)
    references.refuse_retired("version", found.id, found.retired_at)
    return found


def remove(session: Session, version_id: str) -> None:
    """Delete a version."""
    session.delete(_row(session, version_id))
    session.flush()


def citing_version(session: Session, robot_id: int, version_id: str) -> list[str]:
    """Return the versions that continue a version, whether it was ever active, and the jobs not over that use it."""
    children = session.execute(select(VersionRow.id).where(VersionRow.parent_id == version_id)).scalars().all()
    once = select(func.count()).where(ActivationRow.version_id == version_id)
    logged = ["the log of activations"] if session.execute(once).scalar_one() else []
    jobs = session.execute(select(JobRow).where(JobRow.robot_id == robot_id, JobRow.state.not_in(FINAL))).scalars()
    return [*children, *logged, *(job.id for job in jobs if version_id in json.dumps(job.request))]


def of_robot(session: Session, robot_id: int, page: Page = ALL, with_retired: bool = False) -> list[VersionRecord]:
    """Return the versions of a robot, newest first, one more than the page shows; those out of use only when asked for."""
    robot, last = robots.by_id(session, robot_id).name, active_entry(session, robot_id)
    query = _of_robot(select(VersionRow), robot_id, page, with_retired)
    return [_record(found, robot, last) for found in session.execute(query).scalars()]


def list_versions(
    session: Session, robot_id: int, page: Page = ALL, with_retired: bool = False
) -> list[VersionSummary]:
    """Return the same as a list tells it. Covariances and reports, a hundred kB of each version, stay unread."""
    row = VersionRow
    columns = (
        row.id,
        row.parent_id,
        row.job_id,
        row.created_at,
        row.code_version,
        row.name,
        row.notes,
        row.retired_at,
        row.number,
        row.calibration["effects"].label("document"),
        row.report["metrics"].label("errors"),
        row.calibration[TORQUES]["joints"].label("joints"),
    )
    robot, last = robots.by_id(session, robot_id).name, active_entry(session, robot_id)
    found = session.execute(_of_robot(select(*columns), robot_id, page, with_retired))
    return [
        copy_fields(
            VersionSummary,
            one,
            robot=robot,
            active=last is not None and last.version_id == one.id,
            effects=[effect["id"] for effect in one.document or []],
            metrics=as_written(Metrics, one.errors or {}),
            torques=one.joints is not None,
        )
        for one in found
    ]


def _of_robot(query: Select[Any], robot_id: int, page: Page, with_retired: bool) -> Select[Any]:
    row = VersionRow
    query = query.where(row.robot_id == robot_id).order_by(row.created_at.desc(), row.id)
    if not with_retired:
        query = query.where(row.retired_at.is_(None))
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(or_(row.created_at < moment, and_(row.created_at == moment, row.id > key)))
    return query.limit(page.fetch_limit)


def active_of_robots(session: Session) -> list[VersionRecord]:
    """Return the versions that robots are corrected with."""
    last = select(func.max(ActivationRow.id)).group_by(ActivationRow.robot_id)
    query = select(VersionRow, RobotRow.name, ActivationRow).join(
        ActivationRow, ActivationRow.version_id == VersionRow.id
    )
    query = query.join(RobotRow, RobotRow.id == VersionRow.robot_id).where(ActivationRow.id.in_(last))
    return [_record(row, robot, _entry(entry)) for row, robot, entry in session.execute(robots.visible(query))]


def calibration(session: Session, version_id: str) -> core_model.Calibration:
    """Build core's calibration of a version."""
    row = _row(session, version_id)
    return core_model.Calibration.from_document(robots.core_robot(session, row.robot_id), row.calibration)


def torques(session: Session, version_id: str) -> dict[str, Any] | None:
    """Return the model of torques that a version holds; None where it holds none."""
    found: dict[str, Any] | None = _row(session, version_id).calibration.get(TORQUES)
    return found


def covariance(session: Session, version_id: str) -> dict[str, Any]:
    """Return what a version knows about its parameters: {names, matrix, units}, empty when it was not identified."""
    return dict(_row(session, version_id).covariance)


def load_predictive(session: Session, version_id: str) -> core_identify.Predictive | None:
    """Return how far a version says the arm may be from it; None when it has no covariance."""
    row = _row(session, version_id)
    return core_identify.Predictive.from_document(row.covariance, row.report)


def query_for_active_stamp() -> Select[int]:
    """Return the query for a number that changes whenever any robot's active version does.

    The corrector follows activations by it: it polls this number, and calls `active_version` for every robot when the
    number has changed.
    """
    return select(func.coalesce(func.max(ActivationRow.id), 0))


def active_version(session: Session, robot: str) -> ActiveVersion | None:
    """Return the version the robot of this name is corrected with; None when none was ever activated."""
    last = active_entry(session, robots.get(session, robot).id)
    if last is None:
        return None
    row = _row(session, last.version_id)
    limits = CorrectionLimits(**row.limits)
    known = calibration(session, row.id)
    workspace, rules = row.report.get("workspace"), activation_rules(session, row.id)
    return ActiveVersion(robot, row.id, row.sha256, last.id, known, limits, workspace, rules)


def activation_rules(session: Session, version_id: str) -> dict[str, Any] | None:
    """Return the task and rules that a version was activated under the last time; None where that is not known."""
    found: dict[str, Any] | None = fetch_last_kept(session, ReplayRow.rules, version_id)
    return found


def active_entries(session: Session) -> list[ActivationRecord]:
    """Return the last activation of each robot, the one that holds."""
    last = select(func.max(ActivationRow.id)).group_by(ActivationRow.robot_id)
    return [_entry(row) for row in session.execute(select(ActivationRow).where(ActivationRow.id.in_(last))).scalars()]


def active_entry(session: Session, robot_id: int) -> ActivationRecord | None:
    """Return the last activation of a robot, the one that holds."""
    query = select(ActivationRow).where(ActivationRow.robot_id == robot_id).order_by(ActivationRow.id.desc()).limit(1)
    row = session.execute(query).scalar_one_or_none()
    return None if row is None else _entry(row)


def activations(session: Session, robot_id: int, page: Page = ALL) -> list[ActivationRecord]:
    """Return the log of a robot's active versions, newest first, one more than the page shows."""
    query = select(ActivationRow).where(ActivationRow.robot_id == robot_id).order_by(ActivationRow.id.desc())
    if page.number is not None:
        query = query.where(ActivationRow.id < page.number)
    return [_entry(row) for row in session.execute(query.limit(page.fetch_limit)).scalars()]


def _entry(row: ActivationRow) -> ActivationRecord:
    return copy_fields(ActivationRecord, row)


def activate(
    session: Session,
    robot_id: int,
    version_id: str,
    action: str,
    actor: str,
    *,
    forced: bool = False,
    reason: str = "",
    objections: Sequence[Mapping[str, str]] = (),
) -> int:
    """Write into the log that a version is active from now on; returns the number of the entry."""
    before = active_entry(session, robot_id)
    note(session, "active_version", None if before is None else before.version_id, version_id)
    row = ActivationRow(
        robot_id=robot_id,
        version_id=version_id,
        action=action,
        actor=actor,
        forced=forced,
        reason=reason,
        objections=[dict(objection) for objection in objections],
    )
    session.add(row)
    session.flush()
    return row.id


def trainings(session: Session, version_id: str) -> list[Training]:
    """Return what a version was fitted to, and what those were that it continues: their rows are in it too."""
    found, following = [], session.get(VersionRow, version_id)
    while following is not None:
        if any(c["use"] == TORQUES for c in following.campaigns):  # of its line the one before was fitted
            following = None if following.parent_id is None else session.get(VersionRow, following.parent_id)
            continue
        request = session.get_one(JobRow, following.job_id)
        held, options = request.request.get("validation"), request.request.get("options", {})
        used = [(c["id"], tuple(c["sha256"])) for c in following.campaigns if c["use"] == "train"]
        asked = held if isinstance(held, float) and held > 0.0 else None
        unasked = following.report.get(HELD_OUT) if held is None else None
        campaigns, seed = tuple(dict.fromkeys(used)), int(options.get("seed", 0))
        rounded = POSES not in following.report
        by_content = following.report.get(SPLIT) == BY_CONTENT
        moved = following.report.get(REZEROED)
        changed = None if moved is None else len(moved["names"])
        held_out = asked or unasked
        found.append(
            Training(request.kind, campaigns, held_out, seed, unasked is not None, rounded, by_content, changed)
        )
        following = None if following.parent_id is None else session.get(VersionRow, following.parent_id)
    return found


def training_campaign_ids(session: Session, version_id: str) -> frozenset[str]:
    """Return the campaigns that a version, and those that it continues, were fitted to: their clock is its own."""
    found: set[str] = set()
    following = session.get(VersionRow, version_id)
    while following is not None:
        found |= {campaign["id"] for campaign in following.campaigns if campaign["use"] == "train"}
        following = None if following.parent_id is None else session.get(VersionRow, following.parent_id)
    return frozenset(found)


def robots_with_active(session: Session) -> list[str]:
    """Return the names of the robots that have an active version."""
    query = select(RobotRow.name).where(RobotRow.id.in_(select(ActivationRow.robot_id))).order_by(RobotRow.name)
    return list(session.execute(query).scalars())


def fleet_versions(
    session: Session, robot_id: int, allowed: Collection[str] | None
) -> tuple[core_identify.FleetVersion, ...]:
    """Return a version of every other robot in use with the same nominal chain: the active one, else the newest.

    Of robots only those ``allowed`` to whoever asked, None: all. Versions that were identified with a prior of the type, or
    continue one that was, are passed over: a fleet must not learn from itself.
    """
    robot, found = robots.core_robot(session, robot_id), []
    for other in robots.others_in_use(session, robot_id):
        if other.chain is None or (allowed is not None and other.name not in allowed):
            continue
        if not core_identify.same_type(robot, other.robot()):
            continue
        made = _choose_fleet_version(session, other.id)
        if made is not None:
            found_in, known = calibration(session, made.id), covariance(session, made.id)
            found.append(core_identify.FleetVersion.from_calibration(other.name, made.id, found_in, known))
    return tuple(found)


def _choose_fleet_version(session: Session, robot_id: int) -> VersionRecord | None:
    """Return the active version of a robot, else its newest that says what it knows and asked no fleet."""
    known = {one.id: one for one in of_robot(session, robot_id, with_retired=True)}
    made = [
        one
        for one in known.values()
        if one.retired_at is None and one.covariance.get("names") and not _asked_fleet(one, known)
    ]
    return next((one for one in made if one.active), made[0] if made else None)


def _asked_fleet(version: VersionRecord, known: Mapping[str, VersionRecord]) -> bool:
    """Whether a prior of the type had a part in a version, or in one that it continues."""
    following: VersionRecord | None = version
    while following is not None:
        if (following.report.get("prior") or {}).get("source"):
            return True
        following = known.get(following.parent_id or "")
    return False


BY_ACTIVATION, BY_UPGRADE = "activation", "upgrade"


@dataclass(frozen=True)
class Replay:
    """Task and rules of a correction, ``setpoints`` and ``answers``, as the table has them."""

    rules: dict[str, Any]
    setpoints: bytes
    answers: bytes


def fetch_last_kept(session: Session, what: type[ReplayRow] | InstrumentedAttribute[Any], version_id: str) -> Any:
    """Return what was kept with the last activation of a version, the row or a column of it; None where nothing was."""
    query = select(what).join(ActivationRow, ActivationRow.id == ReplayRow.activation_id)
    query = query.where(ActivationRow.version_id == version_id).order_by(ActivationRow.id.desc()).limit(1)
    return session.execute(query).scalar_one_or_none()


def add_answer(session: Session, activation_id: int, replay: Replay, made_by: str = BY_ACTIVATION) -> None:
    """Keep the answers of a version with its activation; those that are kept already stay."""
    if session.get(ReplayRow, activation_id) is not None:
        return
    session.add(
        ReplayRow(
            activation_id=activation_id,
            rules=replay.rules,
            setpoints=replay.setpoints,
            answers=replay.answers,
            made_by=made_by,
            code_version=code_version(),
        )
    )
    session.flush()


def repeat(session: Session, activation_id: int, version_id: str) -> None:
    """Keep with an activation what was kept with the last one of the version, its task and rules too."""
    before = fetch_last_kept(session, ReplayRow, version_id)
    if before is not None:
        names = ("rules", "setpoints", "answers", "made_by", "code_version")
        session.add(ReplayRow(activation_id=activation_id, **{name: getattr(before, name) for name in names}))
        session.flush()


def kept(session: Session, activation_id: int) -> Replay | None:
    """Return what was kept with an activation; None where nothing was."""
    row = session.get(ReplayRow, activation_id)
    return None if row is None else Replay(row.rules, row.setpoints, row.answers)
