"""How good a robot is today, over HTTP."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.contract.today import Today
from kilter_service.versions.today import service
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)


@router.get("/{robot}/today")
def today(robot: str, database: DatabaseOfApp) -> Today:
    """Say how good a robot is today: its newest error on rows that no fit used, and what is missing."""
    return service.of_robot(database, robot)
