"""What can be done with repairs."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime

from kilter_service.contract.today import NewRepair, Repair
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import store as robots


def add(database: Database, robot: str, new: NewRepair, actor: str) -> Repair:
    """Record a repair; the same one twice is one.

    Raises:
        ServiceError: no such robot, one out of use, or a date to come, from which on no check would count.

    """
    now = datetime.now(UTC)
    at = new.at or now
    if at > now:
        raise ServiceError(
            f"The repair is dated {at:%Y-%m-%d %H:%M} UTC, and it is {now:%Y-%m-%d %H:%M}: say when it was done, or leave "
            "the date out for now.",
            code="repair_to_come",
            at=at.isoformat(),
        )
    with database.transaction() as session:
        key = robots.usable(session, robot).id
        if new.campaign_id is not None and not robots.is_campaign_of(session, key, new.campaign_id):
            raise ServiceError(
                f"{robot} has no campaign {new.campaign_id}: name one of its own.",
                code="option_invalid",
                field="campaign_id",
            )
        for known in robots.of_robots(session, [key], new.kind).get(key, []):
            if (known.at, known.what, known.campaign_id, known.rows) == (at, new.what, new.campaign_id, new.rows):
                return known
        return robots.add_repair(session, key, f"rep_{secrets.token_hex(8)}", at, new, actor)


def list_notes(database: Database, robot: str, campaign_id: str) -> list[Repair]:
    """Return the notes on a campaign of a robot and on its rows, oldest first."""
    with database.reading() as session:
        key = robots.get(session, robot).id
        return [one for one in robots.of_robots(session, [key], "note").get(key, []) if one.campaign_id == campaign_id]


def remove(database: Database, robot: str, repair: str) -> None:
    """Delete a repair that was recorded by mistake: its checks count again.

    Raises:
        ServiceError: no such robot or repair.

    """
    with database.transaction() as session:
        robots.remove_repair(session, robots.get(session, robot).id, repair)
