"""Sessions of signed streams over HTTP; nothing is stored."""

from __future__ import annotations

from fastapi import APIRouter, Response

from kilter_service.contract.streams import NewStreamSession, StreamSession
from kilter_service.stream.signing import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(prefix="/v1/robots", tags=["stream"], route_class=GuardedRoute)


@router.post("/{robot}/stream/sessions", status_code=201)
def open_session(
    robot: str, wanted: NewStreamSession, response: Response, database: DatabaseOfApp, settings: SettingsOfApp, _: Admin
) -> StreamSession:
    """Give the keys of a new session of a stream: its setpoints and answers are signed with them."""
    response.headers["Cache-Control"] = "no-store"
    return service.new_session(database, settings, robot, wanted)
