"""Bridges over HTTP: they announce themselves, and people see them."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from kilter_service.contract.streams import Bridge, BridgeList, BridgeNews
from kilter_service.stream.bridges import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/robots", tags=["stream"], route_class=GuardedRoute)
Run = Annotated[str, Path(pattern=r"^[0-9a-f]{16}$", description="Id of the run of a bridge, which it makes itself.")]


@router.get("/{robot}/bridges")
def bridges(robot: str, database: DatabaseOfApp) -> BridgeList:
    """Say which bridges correct the robot, and which did within a day."""
    return service.of_robot(database, robot)


@router.put("/{robot}/bridges/{bridge}")
def announce(robot: str, bridge: Run, news: BridgeNews, database: DatabaseOfApp, _: Admin) -> Bridge:
    """Take what a bridge says of itself; it controls nothing."""
    return service.announce(database, robot, bridge, news)
