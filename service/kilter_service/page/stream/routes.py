"""The stream of a robot: the view, and what moves on it as server-sent events."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, StreamingResponse

from kilter_service.page.route import PageRoute
from kilter_service.page.shell import is_part, render
from kilter_service.page.stream import service
from kilter_service.stream.bridges import service as known_bridges
from kilter_service.stream.live import service as live
from kilter_service.stream.live.followers import get_viewers
from kilter_service.web.auth.following import limit_event_stream
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/robots/{robot}/stream")
def stream(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show what is known of the streams of a robot now; the browser follows what comes after."""
    return render(request, "stream/stream.html", view=service.view(database, settings, robot))


@router.get("/robots/{robot}/bridges")
def bridges(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the bridges of a robot: a part of the view, which asks again every other second."""
    found = known_bridges.of_robot(database, robot).bridges
    template = "stream/bridges.html" if is_part(request) else "stream/bridges_alone.html"
    return render(request, template, robot=robot, bridges=found, names=service.version_names_by_id(database, robot))


@router.get("/robots/{robot}/stream/events")
async def follow(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> StreamingResponse:
    """Tell several times a second what the streams of a robot do."""
    await run_in_threadpool(live.load_robot_view, database, settings, robot)  # refuses a robot that does not exist
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    events = limit_event_stream(request, get_viewers(request.app).events(robot))
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)
