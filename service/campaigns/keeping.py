"""What people call campaigns and note on them; campaigns out of use, and gone."""

from __future__ import annotations

from service.campaigns import store
from service.contract.campaigns import Campaign
from service.contract.references import Change, Tombstone
from service.db import Database, Session
from service.db.tables import now
from service.errors import ServiceError
from service.references import retired
from service.references import store as references
from service.robots import store as robots
from service.robots.resolved import sha256_of
from service.versions import store as versions


def change(database: Database, campaign_id: str, wanted: Change) -> Campaign:
    """Name a campaign, or note something on it.

    Raises:
        ServiceError: no such campaign, or a name that is taken or cannot be.

    """
    with database.transaction() as session:
        row = store.whole_row_of(session, campaign_id)
        if wanted.name is not None and wanted.name != row.name:
            if not wanted.name:
                raise ServiceError("A campaign needs a name: give one.", code="name_invalid")
            references.check_name(session, "campaign", row.robot_id, wanted.name, row.id)
            row.name = wanted.name
        if wanted.notes is not None:
            row.notes = wanted.notes
        session.flush()
        return store.get(session, campaign_id)


def retire(database: Database, campaign_id: str, actor: str) -> Campaign:
    """Take a campaign out of use: no list shows it and no job uses it; what cites it stays as it is."""
    with database.transaction() as session:
        retired.retire(store.whole_row_of(session, campaign_id), actor)
        session.flush()
        return store.get(session, campaign_id)


def restore(database: Database, campaign_id: str) -> Campaign:
    """Bring a campaign back into use.

    Raises:
        ServiceError: no such campaign, or another has its name now.

    """
    with database.transaction() as session:
        row = store.whole_row_of(session, campaign_id)
        if row.retired_at is not None:
            references.check_name(session, "campaign", row.robot_id, row.name, row.id)
            retired.restore(row)
        session.flush()
        return store.get(session, campaign_id)


def purge(database: Database, campaign_id: str, actor: str) -> Tombstone:
    """Delete a campaign with all that was uploaded to it; its hash is kept.

    Raises:
        ServiceError: no such campaign, or a version or a job that is not over cites it.

    """
    with database.transaction() as session:
        campaign = store.get(session, store.whole_row_of(session, campaign_id).id)
        _refuse_cited(session, campaign)
        tombstone = Tombstone(
            id=campaign.id,
            kind="campaign",
            robot=campaign.robot,
            name=campaign.name,
            sha256=sha256_of([upload.sha256 for upload in campaign.uploads]),
            by=actor,
            at=now(),
        )
        references.bury(session, tombstone)
        store.delete_whole(session, campaign_id)
    return tombstone


def _refuse_cited(session: Session, campaign: Campaign) -> None:
    robot_id = robots.get(session, campaign.robot).id
    citing = versions.citing_campaign(session, robot_id, campaign.id) + store.unfinished_jobs(session, campaign.id)
    if citing:
        raise ServiceError(
            f"Campaign {campaign.id} is cited by {', '.join(citing[:10])}{' and more' if len(citing) > 10 else ''}: "
            f"purge those first, or retire it instead (kilter campaigns retire {campaign.id}).",
            code="cited",
            campaign=campaign.id,
            cited_by=citing,
        )
