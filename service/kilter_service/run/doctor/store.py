"""When something was stored last."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import func, select

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import ActivationRow, CampaignRow, JobRow, RobotRow, VersionRow


def newest(database: Database) -> datetime | None:
    """Return the latest time that something says it was stored at."""
    columns = (RobotRow.created_at, CampaignRow.created_at, JobRow.created_at, VersionRow.created_at, ActivationRow.at)
    with database.reading() as session:
        found = [session.execute(select(func.max(column))).scalar_one() for column in columns]
    return max((moment for moment in found if moment is not None), default=None)
