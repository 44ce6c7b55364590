"""Rows of jobs at work: who holds one, what is retired with one that was refused, and which are old enough to go.

Every change is alone in the database (`Database.transaction`), so none can overlap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, Select, String, and_, cast, delete, func, or_, select, update

from kilter_service.contract.jobs.kind import FINAL
from kilter_service.ground import store as references
from kilter_service.ground.db import Session
from kilter_service.ground.db.audited import note
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import (
    NOT_OVER,
    ActivationRow,
    CampaignRow,
    FleetRobotRow,
    HeartbeatRow,
    JobRow,
    VersionRow,
)
from kilter_service.jobs.kinds.drift import REFUSED

WORKER = "worker"  # the process of the heartbeats that count here
MAX_ATTEMPTS = 10  # a job that has ended its worker this often would go on doing so


def query_for_free_jobs(kinds: Sequence[str], worker: str) -> Select[str]:
    """Return the query for a job to claim."""
    return select(JobRow.id).where(_free(kinds, worker)).limit(1)


def claim(session: Session, worker: str, kinds: Sequence[str]) -> Claim | None:
    """Take the oldest job of some kinds; None when there is none.

    Call it when the worker runs none of these kinds: a job that the row says it runs was claimed when the connection broke.
    """
    query = select(JobRow).where(_free(kinds, worker)).order_by(JobRow.created_at, JobRow.id).limit(1)
    row = session.execute(query).scalar_one_or_none()
    if row is None:
        return None
    row.state, row.worker, row.attempts, row.started_at = (
        "running",
        worker,
        row.attempts + 1,
        row.started_at or utc_now(),
    )
    return Claim(row.id, worker, row.attempts)


def _free(kinds: Sequence[str], worker: str) -> ColumnElement[bool]:
    lost = and_(JobRow.state == "running", JobRow.worker == worker)
    return and_(NOT_OVER, JobRow.kind.in_(kinds), or_(JobRow.state == "queued", lost))


def _claim_condition(claim: Claim) -> ColumnElement[bool]:
    row = JobRow
    return and_(
        row.id == claim.job_id, row.state == "running", row.worker == claim.worker, row.attempts == claim.attempt
    )


def holds(session: Session, claim: Claim) -> bool:
    """Whether a claim is good still: nobody cancelled the job, and nobody thought its worker gone."""
    return session.execute(select(JobRow.id).where(_claim_condition(claim))).first() is not None


def advance(session: Session, claim: Claim, fraction: float, stage: str) -> bool:
    """Store the progress; returns whether the claim is good still."""
    values = {"fraction": min(max(fraction, 0.0), 1.0), "stage": stage[:200]}
    done = session.execute(update(JobRow).where(_claim_condition(claim)).values(**values).returning(JobRow.id))
    return done.first() is not None


def beats(session: Session) -> dict[str, datetime]:
    """Return when each worker last said that it is alive."""
    query = select(HeartbeatRow.name, HeartbeatRow.at).where(HeartbeatRow.process == WORKER)
    return {row.name: row.at for row in session.execute(query)}


def holders(session: Session) -> set[str]:
    """Return the workers that jobs say they run in."""
    return set(session.execute(select(JobRow.worker).where(NOT_OVER, JobRow.state == "running").distinct()).scalars())


def bury(session: Session, silent: Mapping[str, datetime]) -> None:
    """Take the heartbeats of workers away that have not spoken since."""
    row = HeartbeatRow
    for name, at in silent.items():
        session.execute(delete(row).where(row.process == WORKER, row.name == name, row.at == at))


def orphans(session: Session) -> list[str]:
    """Queue the jobs again whose worker has no heartbeat; returns their ids. Doing it twice changes nothing.

    A job that has ended ten workers fails.
    """
    alive = select(HeartbeatRow.name).where(HeartbeatRow.process == WORKER)
    found = _running(session, JobRow.worker.not_in(alive))
    for row in found:
        if row.attempts >= MAX_ATTEMPTS:
            message = f"The worker died {MAX_ATTEMPTS} times in this job: see its log."
            row.error = {"code": "internal_error", "message": message}
            row.state, row.stage, row.finished_at = "failed", "failed", utc_now()
            references.count(session, row)
        else:
            _queue(row)
    return [row.id for row in found]


def give_back(session: Session, worker: str) -> None:
    """Queue the jobs of a worker again that was asked to stop."""
    for row in _running(session, JobRow.worker == worker):
        _queue(row)


def _running(session: Session, where: ColumnElement[bool]) -> Sequence[JobRow]:
    return (
        session.execute(select(JobRow).where(NOT_OVER, JobRow.state == "running", where).order_by(JobRow.id))
        .scalars()
        .all()
    )


def _queue(row: JobRow) -> None:
    row.state, row.fraction, row.stage = "queued", 0.0, "queued again: its worker has stopped"


@dataclass(frozen=True)
class Claim:
    """One run of a job: whoever claims the job next has another attempt."""

    job_id: str
    worker: str
    attempt: int


REFUSED_KIND = "drift"
RETIRED = (
    " Campaign {campaign} was retired, so that nothing is compared with it; an administrator can bring it back "
    "(`kilter measure campaigns restore {campaign}`)."
)
KEPT = (
    " Campaign {campaign} is still in use, because {why}: ask an administrator to retire it (`kilter measure campaigns retire "
    "{campaign}`) unless it shows this arm as it is, so that nothing is compared with it."
)
TO_FIT = "it was sent to be fitted"
USED = "other jobs or versions name it"


def retires(kind: str, code: str) -> bool:
    """Whether the campaign of a job of a kind, refused with a code, is to be retired."""
    return kind == REFUSED_KIND and code in REFUSED


def retire_refused_campaign(session: Session, job_id: str, code: str, message: str) -> str:
    """Retire the campaign of a check whose rows were refused, and say so behind the message of the refusal.

    Such rows prove nothing of this arm: too few poses, another arm, tool or temperature. A campaign stays where it was sent to
    be fitted, for it may be of an arm that was rebuilt, and where another job or a version names it: whoever restored it, or
    learnt from it, knows more than the check.
    """
    row = session.get_one(JobRow, job_id)
    if not retires(row.kind, code):
        return message
    (key,) = row.request["campaigns"]
    campaign = session.get_one(CampaignRow, key)
    why = TO_FIT if campaign.role == "train" else USED if _is_used(session, row, key) else None
    if why is not None:
        return message.rstrip() + KEPT.format(campaign=key, why=why)
    references.retire(session, "campaign", key, str(row.asked_by.get("actor", "")))
    return message.rstrip() + RETIRED.format(campaign=key)


def _is_used(session: Session, job: JobRow, campaign: str) -> bool:
    others = select(JobRow.id).where(
        JobRow.robot_id == job.robot_id, JobRow.id != job.id, cast(JobRow.request, String).contains(campaign)
    )
    if session.execute(others.limit(1)).first() is not None:
        return True
    return bool(references.citing_campaign(session, job.robot_id, campaign))


def ended_before(session: Session, moment: datetime, most: int) -> list[str]:
    """Return the oldest jobs that were over before a moment and that nothing needs.

    Needed are the jobs of versions, their evaluations while a robot is corrected with them, the newest completed search of
    each robot, which says what is missing, all checks that were completed, which are a robot's history, and jobs of fleet
    jobs, which list them.
    """
    row = JobRow
    query = select(row.id).where(row.state.in_(FINAL), row.finished_at < moment, *_not_needed())
    return list(session.execute(query.order_by(row.finished_at, row.id).limit(most)).scalars())


def _not_needed() -> tuple[ColumnElement[bool], ...]:
    row, version = JobRow, JobRow.result["version_id"].as_string()
    last = select(func.max(ActivationRow.id)).group_by(ActivationRow.robot_id)
    active = select(ActivationRow.version_id).where(ActivationRow.id.in_(last))
    searched = (row.kind == "gap") & (row.state == "succeeded")
    later = select(func.max(row.created_at)).where(searched).group_by(row.robot_id)
    listed = select(FleetRobotRow.job_id).where(FleetRobotRow.job_id.is_not(None))
    return (
        row.id.not_in(select(VersionRow.job_id)),
        row.id.not_in(listed),
        ~((row.kind == "evaluate") & func.coalesce(version, "").in_(active)),
        ~((row.kind == "drift") & (row.state == "succeeded")),
        ~(searched & row.created_at.in_(later)),
    )


def remove_jobs(session: Session, ids: list[str]) -> None:
    """Delete jobs; the audit names each."""
    for job in ids:
        note(session, f"jobs/{job}", "kept", "purged")
    session.execute(delete(JobRow).where(JobRow.id.in_(ids)))
