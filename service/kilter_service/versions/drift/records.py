"""What is stored of checks, and since when an arm has moved."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

SIX = 1.35  # of a 95 % half width is that of six numbers together
COARSER = 1.5  # times the noise of a check that then says nothing of what no single cause explains


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


# Since when an arm has moved: the day of the last check that showed what changed as it was before.
# A check that agreed may have seen less than the one that alarmed: by fewer poses, by a coarser instrument, or of a
# change that came little by little. It says nothing of when, so the one before it counts.


def last_otherwise(
    causes: Sequence[Mapping[str, Any]], noise_mm: float, poses: int, agreeing: Iterable[StoredCheck]
) -> datetime | None:
    """When a check last showed every one of the causes that may be it otherwise than now; None: none did.

    ``causes`` are documents; where there are none, a check counts that saw as much as the one with ``noise_mm`` and ``poses``.
    """
    for one in sorted(agreeing, key=lambda one: one.at, reverse=True):
        before = {each["name"]: each for each in one.result.get("looked_at") or []}
        if causes:
            shown = all(_differs(cause, before.get(cause["name"])) for cause in causes)
        else:
            shown = _saw_as_much(one.result, noise_mm, poses)
        if shown:
            return one.at
    return None


def _differs(now: Mapping[str, Any], before: Mapping[str, Any] | None) -> bool:
    """Whether some number of a cause is beyond what both checks leave open of it."""
    was = {number["name"]: number for number in (before or {}).get("numbers") or []}
    wider = 1.0 if len(now["numbers"]) == 1 else SIX
    for number in now["numbers"]:
        other = was.get(number["name"])
        if other is None or other["u95"] is None or number["u95"] is None:
            continue
        if abs(number["change"] - other["change"]) > wider * math.hypot(number["u95"], other["u95"]):
            return True
    return False


def _saw_as_much(result: Mapping[str, Any], noise_mm: float, poses: int) -> bool:
    noise, count = result.get("noise_mm"), result.get("poses")
    return noise is None or count is None or (noise <= COARSER * noise_mm and count >= poses)
