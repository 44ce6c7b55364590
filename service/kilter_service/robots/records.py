"""Robots as they are stored."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from kilter_service.contract.units import ControllerCompensation


@dataclass(frozen=True)
class RobotRecord:
    """A stored robot, and how much belongs to it. ``sha256`` is that of its chain, ``source_sha256`` that of the document.

    ``notes`` say what of the document the chain leaves out, ``remarks`` what people noted.
    """

    id: int
    name: str
    document: dict[str, Any]
    created_at: datetime
    campaigns: int
    versions: int
    active_version: str | None
    remarks: str
    controller_compensation: ControllerCompensation
    tolerance_mm: float | None
    check_interval_days: int | None
    retired_at: datetime | None
    notes: list[str]
    sha256: str
    source_sha256: str
