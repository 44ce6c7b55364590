"""Campaigns and uploads as they go over the wire."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_service.campaigns.records import CampaignRecord, UploadRecord
from kilter_service.contract.campaigns import Campaign, Conditions, Role, StoredFile, Upload, Uploaded
from kilter_service.contract.instruments import Instrument
from kilter_service.robots.instruments.validity import remarks


def campaign(
    record: CampaignRecord, robot: str, uploads: Sequence[UploadRecord], instruments: Mapping[str, Instrument]
) -> Campaign:
    """Say all of a campaign of the robot of this name."""
    used = instruments.get(record.instrument or "")
    role: Role = record.role  # type: ignore[assignment]  # checked when it was stored, and again by the model
    return Campaign(
        id=record.id,
        robot=robot,
        name=record.name,
        device=record.device,
        role=role,
        conditions=Conditions(**record.conditions),
        notes=record.notes,
        measured_at=record.measured_at,
        instrument=record.instrument,
        warnings=remarks(used, record.measured_at, record.created_at),
        staged=record.staged,
        created_at=record.created_at,
        retired_at=record.retired_at,
        rows=sum(one.rows for one in uploads),
        uploads=[_upload(one) for one in uploads],
    )


def upload_result(campaign_id: str, record: UploadRecord, total: int, *, new: bool) -> Uploaded:
    """Say what an upload became."""
    return Uploaded(campaign_id=campaign_id, total_rows=total, new=new, **_file(record))


def _upload(record: UploadRecord) -> Upload:
    return Upload(media_type=record.media_type, created_at=record.created_at, **_file(record))


def _file(record: UploadRecord) -> dict[str, Any]:
    return {name: getattr(record, name) for name in StoredFile.model_fields}
