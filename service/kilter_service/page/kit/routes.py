"""The view of the kit."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.kit import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shell import is_part, render
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/robots/{robot}/kit")
def kit(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show how far the views of an arm go, and what they said of it."""
    template = "kit/found.html" if is_part(request) else "kit/kit.html"
    return render(request, template, shown=service.shown_kit(database, robot))
