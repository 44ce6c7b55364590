"""What the jobs that made versions said of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import CampaignRow, JobRow, VersionRow


@dataclass(frozen=True)
class Said:
    """A version that set rows aside: the kind of its job, and what it stored of each row."""

    version_id: str
    name: str
    job_id: str
    kind: str
    rows: list[dict[str, Any]]


def iter_set_aside_rows(session: Session, campaign_id: str) -> Iterator[Said]:
    """Yield what the versions of a campaign's robot say of rows of the campaign, oldest first."""
    version, aside = VersionRow, VersionRow.report["set_aside"]
    query = (
        select(version.id, version.name, version.job_id, JobRow.kind, version.campaigns, aside)
        .join(JobRow, JobRow.id == version.job_id)
        .join(CampaignRow, CampaignRow.robot_id == version.robot_id)
        .where(CampaignRow.id == campaign_id)
        .order_by(version.created_at, version.id)
    )
    for key, name, job, kind, used, rows in session.execute(query):
        if any(one["id"] == campaign_id for one in used):
            mine = [row for row in rows or [] if row.get("campaign") in (campaign_id, None)]
            if mine:
                yield Said(key, name, job, kind, mine)
