"""What becomes of rows that a check refused: page, HTTP, library and command follow this one rule."""

from __future__ import annotations

from sqlalchemy import String, cast, select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import CampaignRow, JobRow
from kilter_service.ground.references import store as references
from kilter_service.jobs.kinds.drift import REFUSED

KIND = "drift"
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
    return kind == KIND and code in REFUSED


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
