"""The audit, for admins."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.audit import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import render
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)
Name = Annotated[str, Query(max_length=200)]


@router.get("/audit")
def show_audit(request: Request, database: DatabaseOfApp, robot: Name = "", actor: Name = "") -> HTMLResponse:
    """Show the newest entries, and whether the record is whole."""
    asked = Asked.from_request(request, ("robot", "actor"))
    found = service.find_entries(database, robot.strip(), actor.strip(), asked)
    return render(request, "audit/list.html", found=found, robot=robot, actor_wanted=actor)
