"""What is typed as tolerance and interval of checks: when a robot is added, and in its settings."""

from __future__ import annotations

from pydantic import ValidationError

from kilter_service.contract.references import RobotChange
from kilter_service.ground.errors import ServiceError

WORDS = {
    "tolerance_mm": "a tolerance in mm, above 0 and at most 1000",
    "check_interval_days": "whole days between checks, from 1 to 3650",
}


def parse_goals(tolerance_mm: str, check_interval_days: str) -> RobotChange:
    """Read both; empty: not stated.

    Raises:
        ServiceError: one is not a number that makes sense.

    """
    typed = {"tolerance_mm": tolerance_mm.strip() or None, "check_interval_days": check_interval_days.strip() or None}
    try:
        return RobotChange.model_validate(typed, strict=False)
    except ValidationError as error:
        place = str(error.errors()[0]["loc"][0])
        raise ServiceError(
            f"{typed.get(place)!r} is not {WORDS[place]}: leave it empty where none is stated.",
            code="payload_invalid",
            field=place,
        ) from None
