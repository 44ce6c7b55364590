"""What is posted of a check whose verdict is not ok."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_service.ground.db.row import utc_now
from kilter_service.jobs.records import UsedRecord

SAID = ("version_id", "verdict", "sentence", "remedy", "p_value", "false_alarm")


def verdict_message(
    job: str, robot: str, used: Sequence[UsedRecord], result: Mapping[str, Any]
) -> dict[str, Any] | None:
    """Return what to post; None: all is well."""
    if result.get("verdict") in (None, "ok"):
        return None
    causes = [{"name": one["name"], "words": one["words"]} for one in result.get("causes") or []]
    return {
        "event": "check", "job_id": job, "robot": robot, "campaigns": [one.id for one in used],
        "at": utc_now().isoformat(), **{name: result.get(name) for name in SAID}, "causes": causes,
    }  # fmt: skip
