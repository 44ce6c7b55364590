"""Correction of whole trajectories over HTTP."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool

from service.campaigns import reading
from service.campaigns.receive import receive
from service.correction import service
from service.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(prefix="/v1/robots", tags=["correction"])

FILE = {"schema": {"type": "string", "format": "binary"}}
COLUMNS = {"schema": {"type": "object", "additionalProperties": {"type": "array"}}}
CONTENT = {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}


@router.post(
    "/{robot}/correct",
    response_class=Response,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
    responses={200: {"content": CONTENT, "description": "The trajectory corrected, with dx_mm, dy_mm, dz_mm, status"}},
)
async def correct(
    robot: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, version: str | None = None
) -> Response:
    """Correct a trajectory (CSV, Parquet or JSON columns) with the active version, or with the one named."""
    media = reading.media_type(request.headers.get("content-type"))
    with tempfile.TemporaryDirectory(prefix="kilter-correct-") as folder:
        path = Path(folder) / "body"
        await receive(request, path, settings.max_upload_mb)
        corrected = await run_in_threadpool(service.correct, database, robot, version, path, media)
    return Response(corrected, media_type=media)
