"""Bridges and sessions of signed streams over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Response

from kilter_service.contract.streams import Bridge, BridgeList, BridgeNews, NewStreamSession, StreamSession
from kilter_service.stream import bridges as service
from kilter_service.stream.signing import service as signing
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import DatabaseOfApp, GuardedRoute, SettingsOfApp

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


session_router = APIRouter(prefix="/v1/robots", tags=["stream"], route_class=GuardedRoute)


@session_router.post("/{robot}/stream/sessions", status_code=201)
def open_session(
    robot: str, wanted: NewStreamSession, response: Response, database: DatabaseOfApp, settings: SettingsOfApp, _: Admin
) -> StreamSession:
    """Give the keys of a new session of a stream: its setpoints and answers are signed with them."""
    response.headers["Cache-Control"] = "no-store"
    return signing.new_session(database, settings, robot, wanted)
