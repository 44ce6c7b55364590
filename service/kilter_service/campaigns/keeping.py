"""Names and notes of campaigns; retiring, restoring and purging them.

A campaign that is another one without some rows says so first in its notes; without that it is one of its own.

A load that nobody stated, in words: the same wherever a load matters, in jobs, their checks and corrections.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_service.campaigns import store
from kilter_service.campaigns.service import load_campaign, refuse_other_servos
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.wording import Change, Tombstone
from kilter_service.ground import store as references
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import store as robots
from kilter_service.robots.documents import hash_canonical_json


def change(database: Database, campaign_id: str, wanted: Change) -> Campaign:
    """Name a campaign, or note something on it.

    Raises:
        ServiceError: no such campaign, or a name that is taken or invalid.

    """
    with database.transaction() as session:
        campaign = store.whole(session, campaign_id)
        if wanted.name is not None and wanted.name != campaign.name:
            if not wanted.name:
                raise ServiceError("A campaign needs a name: give one.", code="name_invalid")
            references.check_name(session, "campaign", campaign.robot_id, wanted.name, campaign.id)
        references.change(session, "campaign", campaign_id, wanted.name, wanted.notes)
        return load_campaign(session, campaign_id)


def retire(database: Database, campaign_id: str, actor: str) -> Campaign:
    """Take a campaign out of use: no list shows it and no job uses it; what cites it stays as it is."""
    with database.transaction() as session:
        references.retire(session, "campaign", store.whole(session, campaign_id).id, actor)
        return load_campaign(session, campaign_id)


def restore(database: Database, campaign_id: str) -> Campaign:
    """Bring a campaign back into use.

    Raises:
        ServiceError: no such campaign, another has its name now, or those in use are of another calibration of the servos.

    """
    with database.transaction() as session:
        refuse_other_servos(session, campaign_id)
        references.restore(session, "campaign", store.whole(session, campaign_id).id)
        return load_campaign(session, campaign_id)


def purge(database: Database, campaign_id: str, actor: str) -> Tombstone:
    """Delete a campaign with all that was uploaded to it; its hash is kept.

    Raises:
        ServiceError: no such campaign, or a version or a job that is not over cites it.

    """
    with database.transaction() as session:
        campaign = store.whole(session, campaign_id)
        citing = references.citing_campaign(session, campaign.robot_id, campaign.id)
        citing += store.unfinished_jobs(session, campaign.id)
        references.refuse_cited("campaign", campaign.id, citing, "purge those first")
        left = Tombstone(
            id=campaign.id,
            kind="campaign",
            robot=robots.by_id(session, campaign.robot_id).name,
            name=campaign.name,
            sha256=hash_canonical_json([upload.sha256 for upload in store.uploads_of_campaign(session, campaign_id)]),
            by=actor,
            at=utc_now(),
        )
        references.add_tombstone(session, left)
        store.delete_whole(session, campaign_id)
    return left


WHOLE = re.compile(r"Campaign (cmp_[0-9a-f]{16}) \(")
READ = 32  # characters of the notes that tell


def format_origin_note(campaign: str, name: str, without: str, actor: str) -> str:
    """Return the sentence with which the notes of the rest begin."""
    return f"Campaign {campaign} ({name}) without rows {without}, set aside by {actor} on the page."


def parse_origin_campaign(notes: str) -> str | None:
    """Return the campaign that a campaign is the rest of, by the beginning of its notes; None: it is one of its own."""
    found = WHOLE.match(notes)
    return None if found is None else found[1]


REMEDY = (
    "Say the load with payload_kg (0 for an empty tool), as a column or for the whole {whole}, or give the robot a default "
    "load."
)


def counted_as_nothing(subject: str, following: Sequence[str]) -> str:
    """Say that a payload which nobody stated counts as 0 kg, and for which effects that matters."""
    named = ", ".join(following[:3]) + (f" and {len(following) - 3} more effects" if len(following) > 3 else "")
    return (
        f"{subject} no payload and the robot has no default load, so it counted as 0 kg: {named} "
        f"{'follows' if len(following) == 1 else 'follow'} the load."
    )
