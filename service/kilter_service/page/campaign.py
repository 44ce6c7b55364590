"""The campaigns of a robot, one of them, its series, and what people change on it."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import Form, Query, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse

from kilter_core.errors import CoreError
from kilter_service.campaigns import keeping, looking, suspicious
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import cached_campaign_facts
from kilter_service.contract.campaigns import Campaign, NewCampaign, Parts
from kilter_service.contract.wording import Change
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import plural
from kilter_service.ground.paging import Page
from kilter_service.ground.tables.reading import PARQUET
from kilter_service.ground.tables.writing import write_table
from kilter_service.page import chosen
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.chosen import keep_columns, named_rows, ranges
from kilter_service.page.shared import asking
from kilter_service.page.shared.lists import Asked, select_page
from kilter_service.page.shared.measured import describe_facts
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import compute
from kilter_service.web.routing import DatabaseOfApp, get_scratch


def load_campaign_view(database: Database, campaign_id: str) -> dict[str, Any]:
    """Return a campaign, its rows (none: ``why`` says why), the versions made with it, and rows that look wrong."""
    campaign = campaigns.get(database, campaign_id)
    seen, why = None, ""
    try:
        # Whoever looks at the page looks at its columns next.
        facts = cached_campaign_facts(database, campaign, lambda rows: keep_columns(campaign, rows))
        seen = describe_facts(facts, campaign=campaign.id)
    except CoreError as error:
        why = error.message
    used = [
        (one, each.use)
        for one in versions.versions_from_campaign(database, campaign.id)
        for each in one.campaigns
        if each.id == campaign.id
    ]
    return {
        "campaign": campaign,
        "seen": seen,
        "why": why,
        "made": used,
        "suspicious": suspicious.of_campaign(database, campaign.id),
        "columns": [
            (name, what if unit == "–" else f"{what}, {unit}")
            for name, what, unit, *_ in (seen["columns"] if seen else ())
        ],
        "noted": robots.list_notes(database, campaign.robot, campaign.id),
    }


LONGEST_NAME, LONGEST_NOTES = 200, 20_000
OF_THE_WHOLE = ("device", "role", "conditions", "measured_at", "instrument")  # holds for the rest too


def store_without_rows(database: Database, campaign_id: str, text: str, actor: str, folder: Path) -> Campaign:
    """Store the rest of a campaign's rows as another campaign; its notes say which rows it lacks, and who said so.

    Raises:
        ServiceError: no such campaign or row, or no row would be left.
        CoreError: the rest would be refused as an upload.

    """
    campaign, rows = named_rows(database, campaign_id, text)
    if len(rows) == campaign.rows:
        raise ServiceError(
            f"That is every row of {campaign.name}: take the campaign out of use instead.", code="payload_invalid"
        )
    content = _encode_remaining_rows(database, campaign, rows)
    path = folder / "rows"
    path.write_bytes(content)
    sha256 = hashlib.sha256(content).hexdigest()
    added = campaigns.add(database, campaign.robot, _new(campaign, rows, actor))
    try:
        campaigns.upload(database, added.id, path, PARQUET, sha256)
    except CoreError:
        campaigns.discard(database, added.id)
        raise
    return campaigns.commit(database, added.id, Parts(sha256=[sha256]))


def _encode_remaining_rows(database: Database, campaign: Campaign, rows: list[int]) -> bytes:
    table = looking.load_campaign_rows(database, campaign.id).table
    kept = np.setdiff1d(np.arange(len(table)), np.array(rows) - 1)
    return write_table(table.take(kept), PARQUET)


def _new(campaign: Campaign, rows: list[int], actor: str) -> NewCampaign:
    ending = f" without {plural(len(rows), 'row')}"
    said = keeping.format_origin_note(campaign.id, campaign.name, ranges(rows), actor)
    notes = f"{said}\n\n{campaign.notes}".strip()
    return NewCampaign(
        name=campaign.name[: LONGEST_NAME - len(ending)] + ending,
        notes=notes if len(notes) <= LONGEST_NOTES else said[:LONGEST_NOTES],
        numbered=True,
        staged=True,
        **{name: getattr(campaign, name) for name in OF_THE_WHOLE},
    )


MOST_TEXT = 6000
Short = Annotated[str, Query(max_length=100)]
Ranges = Annotated[str, Query(max_length=MOST_TEXT)]
RowNumber = Annotated[int, Query(ge=0, le=10**12)]


@router.get("/robots/{robot}/campaigns")
def show_campaigns(robot: str, request: Request, database: DatabaseOfApp, retired: bool = False) -> HTMLResponse:
    """List the campaigns of a robot."""
    found = select_page(
        campaigns.list_campaigns(database, robot, Page(), False, retired).campaigns[::-1],
        Asked.from_request(request, ("role", "retired")),
        lambda one: f"{one.name} {one.device} {one.instrument or ''} {one.notes} {one.id}",
        {
            "name": lambda one: one.name,
            "device": lambda one: one.device or None,
            "rows": lambda one: one.rows,
            "stored": lambda one: one.created_at,
        },
        {"role": lambda one: one.role},
        "-stored",
    )
    name = robots.get(database, robot).name
    return render(request, "campaign/list.html", robot=name, part=found, retired=retired)


@router.get("/campaigns/{campaign}")
def show_campaign(
    campaign: str, request: Request, database: DatabaseOfApp, job: Annotated[str, Query(max_length=100)] = ""
) -> HTMLResponse:
    """Show a campaign; ``job`` proposed its poses."""
    shown = load_campaign_view(database, campaign)
    return render(
        request, "campaign/one.html", shown=shown, proposing=asking.proposal(database, shown["campaign"], job)
    )


@router.get("/campaigns/{campaign}/series.json")
def send_series(
    campaign: str,
    database: DatabaseOfApp,
    column: Annotated[str, Query(max_length=64)],
    first: RowNumber = 1,
    last: RowNumber = 0,
    width: Annotated[int, Query(ge=1, le=10_000)] = 800,
    keep: Annotated[str, Query(max_length=6000, pattern=r"^([0-9]{1,12}(,[0-9]{1,12})*)?$")] = "",
) -> JSONResponse:
    """Return a column as points to draw; rows to keep are always among them."""
    kept = [int(row) for row in keep.split(",") if row]
    return JSONResponse(chosen.series(database, campaign, column, first, last, width, kept))


@router.get("/campaigns/{campaign}/values.json")
def values(campaign: str, database: DatabaseOfApp, version: Short, column: Short) -> JSONResponse:
    """Return a column at the rows that the picture of a version shows."""
    return JSONResponse(chosen.values(database, campaign, version, column))


@router.get("/campaigns/{campaign}/rows.json")
def rows_as_json(campaign: str, database: DatabaseOfApp, rows: Ranges, version: Short = "") -> JSONResponse:
    """Say what is known of rows, for whoever points at them."""
    found = chosen.chosen(database, campaign, rows, version)
    return JSONResponse(
        {"campaign": found["campaign"].name, **{one: found[one] for one in ("joints", "units", "rows")}}
    )


@router.get("/campaigns/{campaign}/rows")
def rows_chosen(
    campaign: str, request: Request, database: DatabaseOfApp, rows: Ranges, version: Short = ""
) -> HTMLResponse:
    """List rows that were chosen."""
    return render(request, "campaign/chosen_part.html", chosen=chosen.chosen(database, campaign, rows, version))


@router.get("/campaigns/{campaign}/rows.csv")
def rows_file(campaign: str, database: DatabaseOfApp, rows: Ranges, version: Short = "") -> Response:
    """Send rows that were chosen, with all their columns."""
    content = chosen.as_csv(database, campaign, rows, version)
    return Response(
        content, media_type="text/csv", headers={"Content-Disposition": f'attachment; filename="{campaign}-rows.csv"'}
    )


@router.post("/campaigns/{campaign}/rows/aside")
async def aside(
    campaign: str,
    request: Request,
    database: DatabaseOfApp,
    actor: Admin,
    rows: Annotated[str, Form(max_length=MOST_TEXT)],
) -> Response:
    """Store a campaign without rows, and go to the form of a job that takes it."""
    with get_scratch(request).folder_for("aside") as folder:
        made = await compute(request, store_without_rows, database, campaign, rows, actor, folder)
    return redirect(request, f"/robots/{made.robot}/jobs?kind=identify&campaigns={made.id}")


@router.post("/campaigns/{campaign}/change")
def change(
    campaign: str,
    request: Request,
    database: DatabaseOfApp,
    name: Annotated[str, Form(max_length=200)],
    notes: Annotated[str, Form(max_length=20_000)] = "",
) -> Response:
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
    return redirect(request, f"/campaigns/{campaign}")
