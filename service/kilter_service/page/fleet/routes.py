"""The first view: all robots of the server, the worst first."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.figures import strip
from kilter_service.page.fleet import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import render
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/")
def fleet(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show a row for each robot."""
    found = service.fleet(database, settings, Asked.from_request(request, ("state",)))
    return render(
        request, "fleet.html", fleet=found, part=found.part, counts=service.COUNTS, ruler=strip.ruler(found.axis)
    )
