"""What is left of what was purged, as it is stored and as it goes over the wire."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Literal

from kilter_service.contract.references import Tombstone

Whose = Literal["campaign", "version", "robot"]


@dataclass(frozen=True)
class TombstoneRecord:
    """What is left of a campaign, a version or a robot."""

    id: str
    kind: Whose
    robot: str
    name: str
    sha256: str
    by: str
    at: datetime


def tombstone(record: TombstoneRecord) -> Tombstone:
    """Say what is left of something that was purged."""
    return Tombstone(**asdict(record))
