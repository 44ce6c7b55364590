"""The campaigns of a robot, one of them, its series, and what people change on it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse

from kilter_service.auth.access import Admin
from kilter_service.campaigns import keeping
from kilter_service.contract.references import Change
from kilter_service.page.campaign import service
from kilter_service.page.route import PageRoute
from kilter_service.page.shared import proposing
from kilter_service.page.shell import redirect, render, root_of
from kilter_service.robots import service as robots
from kilter_service.state import DatabaseOfApp

router = APIRouter(include_in_schema=False, route_class=PageRoute)
Rows = Annotated[int, Query(ge=0, le=10**12)]


@router.get("/robots/{robot}/campaigns")
def listed(robot: str, request: Request, database: DatabaseOfApp, retired: bool = False) -> HTMLResponse:
    """List the campaigns of a robot."""
    found = service.listed(database, robot, retired)
    name = robots.get(database, robot).name
    return render(request, "campaign/list.html", robot=name, campaigns=found, retired=retired)


@router.get("/campaigns/{campaign}")
def one(
    campaign: str, request: Request, database: DatabaseOfApp, job: Annotated[str, Query(max_length=100)] = ""
) -> HTMLResponse:
    """Show a campaign; ``job`` proposed its poses."""
    shown = service.shown(database, campaign)
    return render(request, "campaign/one.html", shown=shown, proposing=proposing.of(database, shown.campaign, job))


@router.get("/campaigns/{campaign}/series.json")
def series(
    campaign: str, database: DatabaseOfApp, column: Annotated[str, Query(max_length=64)], first: Rows = 1,
    last: Rows = 0, width: Annotated[int, Query(ge=1, le=10_000)] = 800,
    keep: Annotated[str, Query(max_length=6000, pattern=r"^([0-9]{1,12}(,[0-9]{1,12})*)?$")] = "",
) -> JSONResponse:  # fmt: skip
    """Return a column as points to draw; rows to keep are always among them."""
    kept = [int(row) for row in keep.split(",") if row]
    return JSONResponse(service.series(database, campaign, column, first, last, width, kept))


@router.post("/campaigns/{campaign}/change")
def change(
    campaign: str, request: Request, database: DatabaseOfApp, name: Annotated[str, Form(max_length=200)],
    notes: Annotated[str, Form(max_length=20_000)] = "",
) -> Response:  # fmt: skip
    """Name a campaign, or note something on it."""
    keeping.change(database, campaign, Change(name=name, notes=notes.replace("\r\n", "\n")))
    return _back(request, campaign)


@router.post("/campaigns/{campaign}/retire")
def retire(campaign: str, request: Request, database: DatabaseOfApp, actor: Admin) -> Response:
    """Take a campaign out of use."""
    keeping.retire(database, campaign, actor)
    return _back(request, campaign)


@router.post("/campaigns/{campaign}/restore")
def restore(campaign: str, request: Request, database: DatabaseOfApp) -> Response:
    """Bring a campaign back into use."""
    keeping.restore(database, campaign)
    return _back(request, campaign)


def _back(request: Request, campaign: str) -> Response:
    return redirect(request, f"{root_of(request)}/campaigns/{campaign}")
