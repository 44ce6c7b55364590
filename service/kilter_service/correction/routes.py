"""Correction of whole trajectories over HTTP."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Literal

from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from kilter_service.bodies import receive
from kilter_service.campaigns import reading
from kilter_service.correction import service
from kilter_service.db import Database
from kilter_service.routing import GuardedRoute
from kilter_service.slots import compute
from kilter_service.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(prefix="/v1/robots", tags=["correction"], route_class=GuardedRoute)

FILE = {"schema": {"type": "string", "format": "binary"}}
NOT_CORRECTED = "Kilter-Not-Corrected"
YAML = "application/yaml"
PIECE_BYTES = 1 << 20
Answer = tuple[IO[bytes], tuple[str, ...]]
COLUMNS = {"schema": {"type": "object", "additionalProperties": {"type": "array"}}}
ANSWER = "The trajectory corrected, with dx_mm, dy_mm, dz_mm, status"
CONTENT = {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}


@router.post(
    "/{robot}/correct",
    response_class=Response,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
    responses={200: {"content": CONTENT | {YAML: FILE}, "description": ANSWER}},
)
async def correct(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    version: str | None = None,
    format: Literal["ros2-yaml"] | None = None,  # noqa: A002 (the name of the export's parameter)
) -> Response:
    """Correct a trajectory (CSV, Parquet or JSON columns) with the active version, or with the one named.

    The numbers are those of the stream. The answer has the format that was sent; ``format=ros2-yaml`` asks for a ROS 2
    JointTrajectory instead. Effects of the version that a correction leaves out are named in ``Kilter-Not-Corrected``.
    """
    media = reading.media_type(request.headers.get("content-type"))
    with tempfile.TemporaryDirectory(prefix="kilter-correct-") as folder:
        path = Path(folder) / "body"
        await receive(request, path, settings.max_upload_mb)
        file, left_out = await compute(
            request, _corrected, database, robot, version, path, media, format, settings.temperature_c
        )
    headers = {"Content-Length": str(file.seek(0, 2))} | ({NOT_CORRECTED: ", ".join(left_out)} if left_out else {})
    return StreamingResponse(_pieces(file), media_type=media if format is None else YAML, headers=headers)


def _corrected(database: Database, robot: str, version: str | None, path: Path, *rest: Any) -> Answer:
    """Correct into a file without a name: a client that reads slowly holds no memory, and leaves nothing when it goes."""
    content, left_out = service.correct(database, robot, version, path, *rest)
    file = tempfile.TemporaryFile(prefix="kilter-corrected-")  # noqa: SIM115 (the answer is sent after this)
    file.write(content)
    return file, left_out


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        file.seek(0)
        while piece := file.read(PIECE_BYTES):
            yield piece
