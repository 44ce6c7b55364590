"""Rows of an arm of servos are of one calibration of them: with other zeros, rows are those of another arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_service.campaigns import store
from kilter_service.ground.db import Session
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import store as robots

CONDITION = "calibration_sha256"


def refuse_other_zeros(session: Session, robot_id: int, robot: str, name: str, conditions: Mapping[str, Any]) -> None:
    """Compare the calibration of a campaign with that of the robot's campaigns in use; one that states none is left alone.

    Raises:
        ServiceError: a campaign of the robot is of another one.

    """
    stated = conditions.get(CONDITION)
    if stated is None:
        return
    for campaign_id in store.ids_of_robot(session, robot_id):
        other = store.get(session, campaign_id)
        has = other.conditions.get(CONDITION)
        if has not in (None, stated):
            raise ServiceError(
                f"Campaign {name!r} was measured with servo calibration {stated[:12]}, campaign {other.name!r} of {robot} with "
                f"{has[:12]}: with other zeros it is another arm. Add a robot for it (`kilter robot add`), or retire the "
                "campaigns of the old calibration and identify anew.",
                code="calibration_differs",
                campaign=other.id,
                stated=stated,
                has=has,
            )


def refuse_other_servos(session: Session, campaign_id: str) -> None:
    """Compare a campaign that comes into use with those that are in use.

    Raises:
        ServiceError: one of them is of another calibration.

    """
    campaign = store.get(session, campaign_id)
    robot = robots.by_id(session, campaign.robot_id).name
    refuse_other_zeros(session, campaign.robot_id, robot, campaign.name, campaign.conditions)
