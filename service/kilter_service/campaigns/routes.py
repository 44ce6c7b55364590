"""Campaigns, observations, and rows that look wrong, over HTTP."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError

from kilter_service.campaigns import keeping, service
from kilter_service.campaigns import suspicious as suspicious_rows
from kilter_service.contract.campaigns import (
    Campaign,
    CampaignList,
    CheckedRows,
    NewCampaign,
    Parts,
    SuspiciousRows,
    Uploaded,
)
from kilter_service.contract.wording import Change, Tombstone
from kilter_service.ground.backup_folder import check_digest
from kilter_service.ground.tables import reading
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import FORM, compute, is_form, parse_json, spool_form, spool_upload
from kilter_service.web.routing import ConditionalRoute, DatabaseOfApp, OnceOnly, PageOfList, SettingsOfApp, get_scratch

router = APIRouter(prefix="/v1", tags=["campaigns"], route_class=ConditionalRoute)

FILE = {"schema": {"type": "string", "format": "binary"}}
COLUMNS = {"schema": {"type": "object", "additionalProperties": {"type": "array", "items": {"type": "number"}}}}
ROWS = {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}
BODY = {"requestBody": {"required": True, "content": ROWS}}
PARTS = ("campaign", "rows")
FORM_OF_BOTH = {
    "schema": {
        "type": "object",
        "required": [*PARTS],
        "properties": {
            "campaign": {
                "type": "string",
                "contentMediaType": reading.JSON,
                "description": "A campaign as it is added, without a filename.",
            },
            "rows": {
                "type": "string",
                "format": "binary",
                "description": "The file, with a filename and its Content-Type.",
            },
        },
    }
}
CHECKED_BODY = {"requestBody": {"required": True, "content": ROWS | {FORM: FORM_OF_BOTH}}}


@router.post("/robots/{robot}/campaigns", status_code=201)
def add(
    robot: str, campaign: NewCampaign, response: Response, database: DatabaseOfApp, once: OnceOnly, _: Admin
) -> Campaign:
    """Add a campaign to a robot."""
    added = service.add(database, robot, campaign, once)
    response.headers["Location"] = f"/v1/campaigns/{added.id}"
    return added


@router.get("/robots/{robot}/campaigns")
def listed(
    robot: str, database: DatabaseOfApp, page: PageOfList, staged: bool = False, retired: bool = False
) -> CampaignList:
    """List the campaigns of a robot; with `staged` those whose parts are not all there yet, with `retired` all others too."""
    return service.list_campaigns(database, robot, page, staged, retired)


@router.post("/robots/{robot}/observations/check", openapi_extra=CHECKED_BODY)
async def check(
    robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, campaign: str | None = None
) -> CheckedRows:
    """Check observations as an upload would, and store nothing: the refusal is that of the upload.

    Rows alone are checked as those of a new campaign of which nothing is stated, with `?campaign=` as those of that
    campaign. A form of the parts `campaign` and `rows` is checked as that campaign would be added, and these rows to it.
    """
    with get_scratch(request).folder_for("check") as folder:
        path = folder / "body"
        into: NewCampaign | str | None = campaign
        if is_form(request):
            limits = settings.max_document_mb, settings.max_upload_mb
            document, kind, sha256 = await spool_form(request, path, PARTS, limits)
            into, media = _parse_new_campaign(await parse_json(document)), reading.media_type(kind)
        else:
            media = reading.media_type(request.headers.get("content-type"))
            sha256 = await spool_upload(request, path, settings.max_upload_mb)
        check_digest(request.headers, sha256)
        return await compute(request, service.check_upload, database, robot, path, media, into, sha256)


def _parse_new_campaign(document: object) -> NewCampaign:
    try:
        return NewCampaign.model_validate(document)
    except ValidationError as error:
        raise RequestValidationError([{**one, "loc": ("body", *one["loc"])} for one in error.errors()]) from error


@router.get("/campaigns/{campaign}")
def get(campaign: str, database: DatabaseOfApp) -> Campaign:
    """Show a campaign and its uploads."""
    return service.get(database, campaign)


@router.get(
    "/campaigns/{campaign}/observations",
    response_class=Response,
    responses={200: {"content": {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}}},
)
def observations(
    campaign: str,
    database: DatabaseOfApp,
    format: Literal["csv", "parquet", "json"] = "csv",  # noqa: A002 (the name of the export's parameter)
) -> Response:
    """Download the rows of a campaign with the columns in which they were uploaded."""
    media = {"csv": reading.CSV, "parquet": reading.PARQUET, "json": reading.JSON}[format]
    headers = {"Content-Disposition": f'attachment; filename="{campaign}.{format}"'}
    return Response(service.rows(database, campaign, media), media_type=media, headers=headers)


@router.post("/campaigns/{campaign}/commit")
def commit(campaign: str, parts: Parts, database: DatabaseOfApp, _: Admin) -> Campaign:
    """Make a staged campaign visible, if it holds exactly the parts that are named; a repeat changes nothing."""
    return service.commit(database, campaign, parts)


@router.patch("/campaigns/{campaign}")
def change(campaign: str, wanted: Change, database: DatabaseOfApp, _: Admin) -> Campaign:
    """Name a campaign, or note something on it."""
    return keeping.change(database, campaign, wanted)


@router.post("/campaigns/{campaign}/retire")
def retire(campaign: str, database: DatabaseOfApp, actor: Admin) -> Campaign:
    """Take a campaign out of use; what was made from it stays as it is."""
    return keeping.retire(database, campaign, actor)


@router.post("/campaigns/{campaign}/restore")
def restore(campaign: str, database: DatabaseOfApp, _: Admin) -> Campaign:
    """Bring a retired campaign back into use."""
    return keeping.restore(database, campaign)


@router.post("/campaigns/{campaign}/purge")
def purge(campaign: str, database: DatabaseOfApp, actor: Admin) -> Tombstone:
    """Delete a campaign that nothing cites, for good; its hash is kept."""
    return keeping.purge(database, campaign, actor)


@router.delete("/campaigns/{campaign}", status_code=204)
def discard(campaign: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete a staged campaign with all that was sent to it."""
    service.discard(database, campaign)


@router.post(
    "/campaigns/{campaign}/observations",
    status_code=201,
    openapi_extra=BODY,
    responses={200: {"model": Uploaded, "description": "These bytes were there already"}},
)
async def upload(
    campaign: str,
    request: Request,
    response: Response,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    once: OnceOnly,
    _: Admin,
) -> Uploaded:
    """Add observations: CSV, Parquet, or JSON columns. A digest of the body (`Content-Digest`, RFC 9530) is checked."""
    media = reading.media_type(request.headers.get("content-type"))
    await run_in_threadpool(service.get, database, campaign)
    with get_scratch(request).folder_for("upload") as folder:
        path = folder / "body"
        sha256 = await spool_upload(request, path, settings.max_upload_mb)
        check_digest(request.headers, sha256)
        done = await compute(request, service.upload, database, campaign, path, media, sha256, once)
    response.status_code = 201 if done.new else 200
    return done


suspicious_router = APIRouter(prefix="/v1/campaigns", tags=["campaigns"], route_class=ConditionalRoute)


@suspicious_router.get("/{campaign}/suspicious")
def suspicious(campaign: str, database: DatabaseOfApp) -> SuspiciousRows:
    """Name the rows of a campaign that look wrong, and who says so: the rows themselves, and every version made of them."""
    return suspicious_rows.of_campaign(database, campaign)
