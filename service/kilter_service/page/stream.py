"""The stream of a robot: the view, and what moves on it as server-sent events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, StreamingResponse

from kilter_service.ground.db import Database
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.page.answers import render, router
from kilter_service.page.figures.plot import Axis, Plot
from kilter_service.page.shared.standing import corrector
from kilter_service.robots import service as robots
from kilter_service.stream import bridges as known_bridges
from kilter_service.stream.live import followers as live
from kilter_service.stream.live.followers import get_viewers
from kilter_service.stream.live.heard import WHY, Second
from kilter_service.stream.live.session import read_corrector_place
from kilter_service.versions import service as versions
from kilter_service.web.auth.token import limit_event_stream
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp

CALM_MM = 0.05  # a correction that is smaller is drawn small
MOST_NAMES = 200  # of versions: one that corrects is hardly ever older


def _draw_minute(minute: Sequence[Second]) -> Plot | None:
    """The last minute at the tool, for whoever has no JavaScript; None where there are not two setpoints in it."""
    if len(minute) < 2:
        return None
    ago = [one.at_s - minute[-1].at_s for one in minute]
    tool = [one.tool_mm for one in minute]
    said = f"The correction at the tool was {min(tool):.3g} to {max(tool):.3g} mm within the last minute."
    up = Axis("correction at the tool, mm", 0.0, max(CALM_MM, 1.15 * max(tool)))
    return Plot("The last minute", Axis("seconds", -60.0, 0.0), up, height=220.0, description=said).line(ago, tool)


def view(database: Database, settings: Settings, robot: str) -> dict[str, Any]:
    """Return the streams of a robot, what is said of them elsewhere, who activated a version, why setpoints are refused.

    Raises:
        ServiceError: no such robot.

    """
    shown = live.load_robot_view(database, settings, robot)
    entries = versions.activations(database, robot, Page(limit=1)).activations
    place = read_corrector_place(settings.corrector_file)
    arm, minutes = robots.get(database, robot), live.load_minutes(database, robot)
    seen = corrector(database, settings)
    return {
        "robot": arm,
        "shown": shown,
        "activation": entries[0] if entries else None,
        "reasons": WHY,
        "endpoint": place.endpoint if place else settings.zenoh_listen,
        "correcting": seen.describe_correction(robot, arm.active_version, arm.controller_compensation),
        "bridges": known_bridges.of_robot(database, robot).bridges,
        "names": version_names_by_id(database, robot),  # of its newest versions
        "minute": lambda stream: [asdict(one) for one in minutes.get(stream, [])],  # as the browser takes it
        "drawn": lambda stream: _draw_minute(minutes.get(stream, [])),
    }


def version_names_by_id(database: Database, robot: str) -> dict[str, str]:
    """Return what the newest versions of a robot are called, by id."""
    return {
        one.id: display_name(one) for one in versions.list_versions(database, robot, Page(limit=MOST_NAMES)).versions
    }


@router.get("/robots/{robot}/stream")
def stream(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show what is known of the streams of a robot now; the browser follows what comes after."""
    return render(request, "stream/stream.html", view=view(database, settings, robot))


@router.get("/robots/{robot}/bridges")
def bridges(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the bridges of a robot: a part of the view, which asks again every other second."""
    found = known_bridges.of_robot(database, robot).bridges
    return render(
        request, "stream/bridges.html", robot=robot, bridges=found, names=version_names_by_id(database, robot)
    )


@router.get("/robots/{robot}/stream/events")
async def follow(robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> StreamingResponse:
    """Tell several times a second what the streams of a robot do."""
    await run_in_threadpool(live.load_robot_view, database, settings, robot)  # refuses a robot that does not exist
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    events = limit_event_stream(request, get_viewers(request.app).events(robot))
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)
