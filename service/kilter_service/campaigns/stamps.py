"""When a campaign was measured, by the time stamps of its rows where nobody said it."""

from __future__ import annotations

from datetime import UTC, datetime

from kilter_core.observations import SINCE_1970_S
from kilter_files.ground.later import pc
from kilter_service.campaigns import store
from kilter_service.ground.db import Session

TIME = "t_s"


def last_stamp(session: Session, campaign_id: str) -> datetime | None:
    """Return when the last row of a campaign was measured; None where its times do not count from 1970."""
    if not any(TIME in upload.columns for upload in store.uploads_of_campaign(session, campaign_id)):
        return None
    latest = pc.max(store.table(session, campaign_id).column(TIME)).as_py()
    if latest is None or latest < SINCE_1970_S:
        return None
    # Stamps without a zone are taken for UTC: those of a lab east of it may be ahead.
    return min(datetime.fromtimestamp(latest, UTC), datetime.now(UTC))


def date_by_stamps(session: Session, campaign_id: str, before: datetime | None = None) -> None:
    """Date a campaign by its last stamp, unless somebody said when it was measured; ``before`` is what stamps said so far."""
    if store.get(session, campaign_id).measured_at in (None, before):
        store.set_measured_at(session, campaign_id, last_stamp(session, campaign_id))
