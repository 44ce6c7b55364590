"""The campaigns of a robot, one of them, its series, and what people change on it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse

from kilter_service.campaigns import keeping
from kilter_service.contract.references import Change
from kilter_service.page.campaign import chosen, service
from kilter_service.page.campaign.without import store_without_rows
from kilter_service.page.route import PageRoute
from kilter_service.page.shared import proposing
from kilter_service.page.shared.lists import Asked
from kilter_service.page.shell import get_root_path, is_part, redirect, render
from kilter_service.robots import service as robots
from kilter_service.web.auth.access import Admin
from kilter_service.web.concurrency import compute
from kilter_service.web.state import DatabaseOfApp, get_scratch

router = APIRouter(include_in_schema=False, route_class=PageRoute)
MOST_TEXT = 6000
Short = Annotated[str, Query(max_length=100)]
Ranges = Annotated[str, Query(max_length=MOST_TEXT)]
Rows = Annotated[int, Query(ge=0, le=10**12)]


@router.get("/robots/{robot}/campaigns")
def list_campaigns(robot: str, request: Request, database: DatabaseOfApp, retired: bool = False) -> HTMLResponse:
    """List the campaigns of a robot."""
    found = service.list_campaigns(database, robot, retired, Asked.from_request(request, ("role", "retired")))
    name = robots.get(database, robot).name
    return render(request, "campaign/list.html", robot=name, part=found, retired=retired)


@router.get("/campaigns/{campaign}")
def show_campaign(
    campaign: str, request: Request, database: DatabaseOfApp, job: Annotated[str, Query(max_length=100)] = ""
) -> HTMLResponse:
    """Show a campaign; ``job`` proposed its poses."""
    shown = service.load_campaign_view(database, campaign)
    return render(
        request, "campaign/one.html", shown=shown, proposing=proposing.proposal(database, shown.campaign, job)
    )


@router.get("/campaigns/{campaign}/series.json")
def series(
    campaign: str, database: DatabaseOfApp, column: Annotated[str, Query(max_length=64)], first: Rows = 1,
    last: Rows = 0, width: Annotated[int, Query(ge=1, le=10_000)] = 800,
    keep: Annotated[str, Query(max_length=6000, pattern=r"^([0-9]{1,12}(,[0-9]{1,12})*)?$")] = "",
) -> JSONResponse:  # fmt: skip
    """Return a column as points to draw; rows to keep are always among them."""
    kept = [int(row) for row in keep.split(",") if row]
    return JSONResponse(service.series(database, campaign, column, first, last, width, kept))


@router.get("/campaigns/{campaign}/values.json")
def values(campaign: str, database: DatabaseOfApp, version: Short, column: Short) -> JSONResponse:
    """Return a column at the rows that the picture of a version shows."""
    return JSONResponse(chosen.values(database, campaign, version, column))


@router.get("/campaigns/{campaign}/rows.json")
def rows_as_json(campaign: str, database: DatabaseOfApp, rows: Ranges, version: Short = "") -> JSONResponse:
    """Say what is known of rows, for whoever points at them."""
    found = chosen.chosen(database, campaign, rows, version)
    return JSONResponse(
        {
            "campaign": found.campaign.name,
            "joints": found.joints,
            "units": found.units,
            "rows": [asdict(one) for one in found.rows],
        }
    )


@router.get("/campaigns/{campaign}/rows")
def rows_chosen(
    campaign: str, request: Request, database: DatabaseOfApp, rows: Ranges, version: Short = ""
) -> HTMLResponse:
    """List rows that were chosen."""
    template = "campaign/chosen_part.html" if is_part(request) else "campaign/chosen.html"
    return render(request, template, chosen=chosen.chosen(database, campaign, rows, version))


@router.get("/campaigns/{campaign}/rows.csv")
def rows_file(campaign: str, database: DatabaseOfApp, rows: Ranges, version: Short = "") -> Response:
    """Send rows that were chosen, with all their columns."""
    content = chosen.as_csv(database, campaign, rows, version)
    return Response(
        content, media_type="text/csv", headers={"Content-Disposition": f'attachment; filename="{campaign}-rows.csv"'}
    )


@router.post("/campaigns/{campaign}/rows/aside")
async def aside(
    campaign: str, request: Request, database: DatabaseOfApp, actor: Admin,
    rows: Annotated[str, Form(max_length=MOST_TEXT)],
) -> Response:  # fmt: skip
    """Store a campaign without rows, and go to the form of a job that takes it."""
    with get_scratch(request).folder_for("aside") as folder:
        made = await compute(request, store_without_rows, database, campaign, rows, actor, folder)
    return redirect(request, f"{get_root_path(request)}/robots/{made.robot}/jobs?kind=identify&campaigns={made.id}")


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
    return redirect(request, f"{get_root_path(request)}/campaigns/{campaign}")
