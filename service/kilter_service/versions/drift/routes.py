"""The checks of robots, over HTTP."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.contract.drift import DriftHistory, DriftList
from kilter_service.versions.drift import service
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1", tags=["robots"], route_class=ConditionalRoute)


@router.get("/robots/{robot}/drift")
def drift(robot: str, database: DatabaseOfApp) -> DriftHistory:
    """Return the checks of a robot, the control charts of its active version, and how it stands by them."""
    return service.of_robot(database, robot)


@router.get("/drift")
def drifts(database: DatabaseOfApp) -> DriftList:
    """Return how all robots stand by their checks, the worst first."""
    return service.of_robots(database)
