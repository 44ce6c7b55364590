"""What the palette finds."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from kilter_service.page.find import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shell import render
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)


@router.get("/find")
def find(
    request: Request,
    database: DatabaseOfApp,
    sought: Annotated[str, Query(max_length=100)] = "",
    robot: Annotated[str, Query(max_length=64)] = "",
) -> HTMLResponse:
    """Find what is called so; ``robot`` is the one that is looked at."""
    return render(request, "find.html", places=service.find(database, sought, robot))
