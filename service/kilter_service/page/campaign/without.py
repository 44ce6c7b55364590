"""A campaign without the rows that somebody set aside: the next job takes it instead, and the one measured stays whole."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from kilter_core.errors import CoreError
from kilter_service.campaigns import looking, rest
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign, NewCampaign, Parts
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables.reading import PARQUET
from kilter_service.ground.tables.writing import write_table
from kilter_service.ground.texts import plural
from kilter_service.page.campaign.chosen import named_rows, ranges

LONGEST_NAME, LONGEST_NOTES = 200, 20_000
OF_THE_WHOLE = ("device", "role", "conditions", "measured_at", "instrument")  # holds for the rest too


def store_without_rows(database: Database, campaign_id: str, text: str, actor: str, folder: Path) -> Campaign:
    """Store the rest of a campaign's rows as another campaign; its notes say which rows it lacks, and who said so.

    Raises:
        ServiceError: no such campaign or row, or no row would be left.
        CoreError: the rest would be refused as an upload.

    """
    campaign, rows = named_rows(database, campaign_id, text)
    if len(rows) == campaign.rows:
        raise ServiceError(
            f"That is every row of {campaign.name}: take the campaign out of use instead.", code="payload_invalid"
        )
    content = _encode_remaining_rows(database, campaign, rows)
    path = folder / "rows"
    path.write_bytes(content)
    sha256 = hashlib.sha256(content).hexdigest()
    added = campaigns.add(database, campaign.robot, _new(campaign, rows, actor))
    try:
        campaigns.upload(database, added.id, path, PARQUET, sha256)
    except CoreError:
        campaigns.discard(database, added.id)
        raise
    return campaigns.commit(database, added.id, Parts(sha256=[sha256]))


def _encode_remaining_rows(database: Database, campaign: Campaign, rows: list[int]) -> bytes:
    table = looking.load_campaign_rows(database, campaign.id).table
    kept = np.setdiff1d(np.arange(len(table)), np.array(rows) - 1)
    return write_table(table.take(kept), PARQUET)


def _new(campaign: Campaign, rows: list[int], actor: str) -> NewCampaign:
    ending = f" without {plural(len(rows), 'row')}"
    said = rest.format_origin_note(campaign.id, campaign.name, ranges(rows), actor)
    notes = f"{said}\n\n{campaign.notes}".strip()
    return NewCampaign(
        name=campaign.name[: LONGEST_NAME - len(ending)] + ending,
        notes=notes if len(notes) <= LONGEST_NOTES else said[:LONGEST_NOTES],
        numbered=True,
        staged=True,
        **{name: getattr(campaign, name) for name in OF_THE_WHOLE},
    )
