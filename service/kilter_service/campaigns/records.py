"""Campaigns and uploads as they are stored."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any


@dataclass(frozen=True)
class UploadRecord:
    """A stored file of observations."""

    sha256: str
    rows: int
    columns: list[str]
    media_type: str
    created_at: datetime


@dataclass(frozen=True)
class CampaignRecord:
    """A stored campaign, without its uploads."""

    id: str
    robot_id: int
    name: str
    device: str
    role: str
    conditions: dict[str, Any]
    notes: str
    staged: bool
    measured_at: datetime | None
    instrument: str | None
    created_at: datetime
    retired_at: datetime | None
