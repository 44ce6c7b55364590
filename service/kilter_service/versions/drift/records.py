"""What is stored of checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any


@dataclass(frozen=True)
class StoredCheck:
    """A check that was made, and when its rows were measured, or sent.

    ``whole``: every cause was looked at. Where frames were set up anew, or places were not measured, it says how the arm
    stands, and is in no sum.
    """

    job_id: str
    campaign_id: str
    at: datetime
    result: Mapping[str, Any]
    whole: bool = True


@dataclass(frozen=True)
class Activated:
    """An entry of the log of active versions; ``rezeroed``: a version of what moved."""

    version_id: str
    at: datetime
    action: str
    rezeroed: bool
