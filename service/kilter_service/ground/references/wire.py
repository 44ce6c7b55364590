"""Tombstones as they go over the wire."""

from __future__ import annotations

from dataclasses import asdict

from kilter_service.contract.references import Tombstone
from kilter_service.ground.references.records import TombstoneRecord


def tombstone(record: TombstoneRecord) -> Tombstone:
    """Say what is left of something that was purged."""
    return Tombstone(**asdict(record))
