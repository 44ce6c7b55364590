"""Campaigns and uploads as they go over the wire."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kilter_service.campaigns.records import CampaignRecord, UploadRecord
from kilter_service.contract.campaigns import Campaign, Conditions, Upload, Uploaded
from kilter_service.contract.instruments import Instrument
from kilter_service.ground.by_name import copy_fields
from kilter_service.robots.instruments.validity import remarks


def campaign(
    record: CampaignRecord, robot: str, uploads: Sequence[UploadRecord], instruments: Mapping[str, Instrument]
) -> Campaign:
    """Say all of a campaign of the robot of this name."""
    used = instruments.get(record.instrument or "")
    return copy_fields(
        Campaign,
        record,
        robot=robot,
        conditions=Conditions(**record.conditions),
        warnings=remarks(used, record.measured_at, record.created_at),
        rows=sum(one.rows for one in uploads),
        uploads=[copy_fields(Upload, one) for one in uploads],
    )


def upload_result(campaign_id: str, record: UploadRecord, total: int, *, new: bool) -> Uploaded:
    """Say what an upload became."""
    return copy_fields(Uploaded, record, campaign_id=campaign_id, total_rows=total, new=new)
