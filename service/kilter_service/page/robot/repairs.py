"""Repairs as the form of a robot states them."""

from __future__ import annotations

from datetime import UTC, datetime

from kilter_service.contract.drift import NewRepair
from kilter_service.ground.errors import ServiceError

LONGEST = 200  # letters of what was done
LONGEST_DATE = 40


def parse_repair(what: str, at: str) -> NewRepair:
    """Read what was done, and when, in UTC; an empty ``at`` is now.

    Raises:
        ServiceError: it does not say what was done, or the date is none.

    """
    if not what.strip():
        raise ServiceError("Say what was done, as: gear of joint 3 replaced.", code="payload_invalid", field="what")
    return NewRepair(what=what.strip(), at=_moment(at.strip()))


def _moment(text: str) -> datetime | None:
    if not text:
        return None
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise ServiceError(
            f"{text!r} is not a date and a time: give it as 2026-11-18T14:30, in UTC, or leave it empty for now.",
            code="payload_invalid",
            field="at",
        ) from None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found
