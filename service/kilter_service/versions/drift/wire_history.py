"""Checks and marks as they go over the wire."""

from __future__ import annotations

from kilter_service.contract.drift import CheckOfRobot, DriftMark, Mark, Repair
from kilter_service.versions.drift.records import Activated, StoredCheck


def check(one: StoredCheck) -> CheckOfRobot:
    """Say what a check said."""
    return CheckOfRobot(
        job_id=one.job_id,
        campaign_id=one.campaign_id,
        version_id=str(one.result["version_id"]),
        at=one.at,
        verdict=one.result["verdict"],
        sentence=str(one.result["sentence"]),
        p_value=float(one.result["p_value"]),
        temperature_c=one.result.get("temperature_c"),
        whole=one.whole,
    )


def mark(one: Activated) -> DriftMark:
    """Say what was done to a robot's version."""
    what: Mark = "rolled back" if one.action == "rollback" else "re-zeroed" if one.rezeroed else "activated"
    return DriftMark(at=one.at, what=what, version_id=one.version_id)


def repair(one: Repair) -> DriftMark:
    """Say what somebody did to the arm."""
    return DriftMark(at=one.at, what="repair", version_id="", note=one.what, repair_id=one.id)


def valid_again_mark(first: StoredCheck) -> DriftMark:
    """Say that a version holds again since a check."""
    return DriftMark(at=first.at, what="repaired", version_id=str(first.result["version_id"]))
