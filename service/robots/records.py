"""Robots as they are stored."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any


@dataclass(frozen=True)
class RobotRecord:
    """A stored robot, and how much belongs to it."""

    id: int
    name: str
    document: dict[str, Any]
    created_at: datetime
    campaigns: int
    versions: int
    active_version: str | None
