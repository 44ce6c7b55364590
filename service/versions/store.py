"""Rows of versions and activations, and what they become in core."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select

from service.contract.jobs.job import FINAL
from service.contract.versions import Activation, CorrectionLimits, Objection, UsedCampaign, Version, VersionSummary
from service.db import Session
from service.db.tables import ActivationRow, JobRow, RobotRow, VersionRow
from service.errors import ServiceError
from service.references import store as references
from service.references.retired import refuse_retired
from service.robots import store as robots
from service.robots.resolved import sha256_of
from service.versions.objections import objections_of

if TYPE_CHECKING:
    from core.identify.predictive import Predictive
    from core.model import Calibration


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
    ``max_joint`` (rad) and ``max_position`` (m) are the largest correction the version may make.
    """

    robot: str
    id: str
    sha256: str
    epoch: int
    calibration: Calibration
    max_joint: float
    max_position: float


HELD_OUT = "held_out_fraction"  # what a job held out by itself, in the report of its version


@dataclass(frozen=True)
class Training:
    """What a version was fitted to: campaigns with the hashes of their uploads, in the order of the fit.

    ``fraction`` of the poses was held out by a job of ``kind`` with ``seed``; None when all were fitted. ``unasked`` says
    that the job held them out by its own rule. ``rounded``: poses were told by rounded readings then.
    """

    kind: str
    campaigns: tuple[tuple[str, tuple[str, ...]], ...]
    fraction: float | None
    seed: int
    unasked: bool = False
    rounded: bool = False


ROBOT_HASHED = 2  # the hash scheme of new versions: calibration, limits and the robot's chain
POSES, BY_DISTANCE = "poses", "by distance"  # versions without it were split by rounded readings


def add(session: Session, robot_id: int, job_id: str, new: NewVersion) -> str:
    """Store the version of a job and return its id; the same job again changes nothing."""
    version_id = f"ver_{job_id.removeprefix('job_')}"
    if session.get(VersionRow, version_id) is not None:
        return version_id
    chain = robots.by_id(session, robot_id).sha256
    session.add(
        VersionRow(
            id=version_id,
            robot_id=robot_id,
            parent_id=new.parent_id,
            job_id=job_id,
            sha256=sha256_of({"calibration": new.calibration, "limits": new.limits, "robot": chain}),
            hash_scheme=ROBOT_HASHED,
            name=references.free_name(session, "version", robot_id, new.name) if new.name else "",
            robot_sha256=chain,
            calibration=new.calibration,
            report={**new.report, POSES: BY_DISTANCE},
            covariance=new.covariance,
            campaigns=new.campaigns,
            limits=new.limits,
            code_version=new.code_version,
        )
    )
    session.flush()
    return version_id


def row_of(session: Session, version_id: str) -> VersionRow:
    """Return the row of a version.

    Raises:
        ServiceError: there is none.

    """
    row = session.get(VersionRow, version_id)
    if row is None:
        raise ServiceError(
            f"There is no version {version_id!r}: list them with GET /v1/robots/{{robot}}/versions."
            + references.gone(session, "version", version_id),
            code="version_not_found",
            version=version_id,
        )
    return row


OF_ITS_OWN = ("parameters", "null_directions", "noise_mm", "warnings", "metrics")  # parts of a report with fields


def get(session: Session, version_id: str) -> Version:
    """Return a version with all it holds."""
    row = row_of(session, version_id)
    return Version(
        **_summary(session, row).model_dump(),
        sha256=row.sha256,
        hash_scheme=row.hash_scheme,
        robot_sha256=row.robot_sha256,
        campaigns=[UsedCampaign(**campaign) for campaign in row.campaigns],
        limits=CorrectionLimits(**row.limits),
        parameters=row.report.get("parameters", []),
        null_directions=row.report.get("null_directions", []),
        noise_mm=row.report.get("noise_mm"),
        warnings=row.report.get("warnings", []),
        objections=objections_of(row.report, CorrectionLimits(**row.limits)),
        details={key: value for key, value in row.report.items() if key not in OF_ITS_OWN},
        covariance=row.covariance,
    )


def usable_row_of(session: Session, version_id: str) -> VersionRow:
    """Return the row of a version that is in use.

    Raises:
        ServiceError: there is none, or it is retired.

    """
    row = row_of(session, version_id)
    refuse_retired("version", row.id, row.retired_at)
    return row


def citing_campaign(session: Session, robot_id: int, campaign_id: str) -> list[str]:
    """Return the versions that were made from a campaign."""
    rows = session.execute(select(VersionRow.id, VersionRow.campaigns).where(VersionRow.robot_id == robot_id))
    return [version for version, campaigns in rows if any(used["id"] == campaign_id for used in campaigns)]


def citing_version(session: Session, robot_id: int, version_id: str) -> list[str]:
    """Return the versions that continue a version, whether it was ever active, and the jobs not over that use it."""
    children = session.execute(select(VersionRow.id).where(VersionRow.parent_id == version_id)).scalars().all()
    once = select(func.count()).where(ActivationRow.version_id == version_id)
    logged = ["the log of activations"] if session.execute(once).scalar_one() else []
    jobs = session.execute(select(JobRow).where(JobRow.robot_id == robot_id, JobRow.state.not_in(FINAL))).scalars()
    return [*children, *logged, *(job.id for job in jobs if version_id in json.dumps(job.request))]


def of_robot(session: Session, robot_id: int, retired: bool = False) -> list[VersionSummary]:
    """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
    query = select(VersionRow).where(VersionRow.robot_id == robot_id)
    if not retired:
        query = query.where(VersionRow.retired_at.is_(None))
    rows = session.execute(query.order_by(VersionRow.created_at.desc(), VersionRow.id)).scalars()
    return [_summary(session, row) for row in rows]


def calibration(session: Session, version_id: str) -> Calibration:
    """Build core's calibration of a version."""
    from core.model import Calibration  # loads compiled kernels: not at the start of the API process

    row = row_of(session, version_id)
    return Calibration.from_document(robots.core_robot(session, row.robot_id), row.calibration)


def covariance(session: Session, version_id: str) -> dict[str, Any]:
    """Return what a version knows about its parameters: {names, matrix, units}, empty when it was not identified."""
    return dict(row_of(session, version_id).covariance)


def known(session: Session, version_id: str) -> Predictive | None:
    """Return how far a version says the arm may be from it; None when it has no covariance."""
    from core.identify.predictive import Predictive

    row = row_of(session, version_id)
    return Predictive.from_document(row.covariance, row.report)


def active_stamp(session: Session) -> int:
    """Return a number that changes whenever any robot's active version does; cheap enough to poll every 100 ms.

    The corrector's way to follow activations without HTTP: poll this, and when it differs from the last one, call
    `active_version` for the robots it serves (or `service.versions.service.active_calibrations` for all).
    """
    return session.execute(select(func.coalesce(func.max(ActivationRow.id), 0))).scalar_one()


def active_version(session: Session, robot: str) -> ActiveVersion | None:
    """Return the version the robot of this name is corrected with; None when none was ever activated."""
    last = active_row(session, robots.get(session, robot).id)
    if last is None:
        return None
    row = row_of(session, last.version_id)
    limits = CorrectionLimits(**row.limits)
    return ActiveVersion(
        robot=robot,
        id=row.id,
        sha256=row.sha256,
        epoch=last.id,
        calibration=calibration(session, row.id),
        max_joint=math.radians(limits.max_joint_deg),
        max_position=limits.max_position_mm * 1e-3,
    )


def active_row(session: Session, robot_id: int) -> ActivationRow | None:
    """Return the last activation of a robot, the one that holds."""
    query = select(ActivationRow).where(ActivationRow.robot_id == robot_id).order_by(ActivationRow.id.desc()).limit(1)
    return session.execute(query).scalar_one_or_none()


def activations(session: Session, robot_id: int) -> list[Activation]:
    """Return the log of a robot's active versions, newest first."""
    query = select(ActivationRow).where(ActivationRow.robot_id == robot_id).order_by(ActivationRow.id.desc())
    return [
        Activation(
            version_id=row.version_id,
            action=row.action,
            actor=row.actor,
            at=row.at,
            forced=row.forced,
            reason=row.reason,
            objections=[Objection(**objection) for objection in row.objections],
        )
        for row in session.execute(query).scalars()
    ]


def activate(
    session: Session,
    robot_id: int,
    version_id: str,
    action: str,
    actor: str,
    *,
    forced: bool = False,
    reason: str = "",
    objections: Sequence[Objection] = (),
) -> None:
    """Write into the log that a version is active from now on."""
    session.add(
        ActivationRow(
            robot_id=robot_id,
            version_id=version_id,
            action=action,
            actor=actor,
            forced=forced,
            reason=reason,
            objections=[objection.model_dump() for objection in objections],
        )
    )
    session.flush()


def trainings(session: Session, version_id: str) -> list[Training]:
    """Return what a version was fitted to, and what those were that it continues: their rows are in it too."""
    found, following = [], session.get(VersionRow, version_id)
    while following is not None:
        request = session.get_one(JobRow, following.job_id)
        held, options = request.request.get("validation"), request.request.get("options", {})
        used = [(c["id"], tuple(c["sha256"])) for c in following.campaigns if c["use"] == "train"]
        asked = held if isinstance(held, float) and held > 0.0 else None
        unasked = following.report.get(HELD_OUT) if held is None else None
        campaigns, seed = tuple(dict.fromkeys(used)), int(options.get("seed", 0))
        rounded = POSES not in following.report
        found.append(Training(request.kind, campaigns, asked or unasked, seed, unasked is not None, rounded))
        following = None if following.parent_id is None else session.get(VersionRow, following.parent_id)
    return found


def robots_with_active(session: Session) -> list[str]:
    """Return the names of the robots that have an active version."""
    query = select(RobotRow.name).where(RobotRow.id.in_(select(ActivationRow.robot_id))).order_by(RobotRow.name)
    return list(session.execute(query).scalars())


def summary(session: Session, version_id: str) -> VersionSummary:
    """Return what lists tell of a version."""
    return _summary(session, row_of(session, version_id))


def _summary(session: Session, row: VersionRow) -> VersionSummary:
    last = active_row(session, row.robot_id)
    return VersionSummary(
        id=row.id,
        robot=robots.by_id(session, row.robot_id).name,
        active=last is not None and last.version_id == row.id,
        parent_id=row.parent_id,
        job_id=row.job_id,
        created_at=row.created_at,
        code_version=row.code_version,
        effects=[effect["id"] for effect in row.calibration["effects"]],
        metrics=row.report.get("metrics", {}),
        name=row.name,
        notes=row.notes,
        retired_at=row.retired_at,
    )
