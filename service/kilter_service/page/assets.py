"""The page's scripts and styles: bundled by `make page`, shipped as files whose names hold their hash.

Whoever runs Kilter builds nothing. `static/manifest.json` says which file each name stands for.
"""

from __future__ import annotations

import gzip
import json
import mimetypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from fastapi import APIRouter, Request, Response

from kilter_service.ground.errors import ServiceError
from kilter_service.web.routing import FOR_GOOD, GuardedRoute

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
FOLDER = "static"


@dataclass(frozen=True)
class Manifest:
    """``files``: the hashed file of each name; ``sources``: SHA-256 of what they were made from."""

    files: Mapping[str, str]
    sources: Mapping[str, str]


@cache
def manifest() -> Manifest:
    """Return what `make page` wrote."""
    return Manifest(**json.loads((files("kilter_service.page") / FOLDER / "manifest.json").read_text(encoding="utf-8")))


def hashed_file_name(name: str) -> str:
    """Return the file that a name (``page.js``) stands for."""
    return manifest().files[name]


@router.get("/assets/{name}")
def asset(name: str, request: Request) -> Response:
    """Send a file; its name changes with its content, so that browsers keep it for good."""
    if name not in manifest().files.values():
        raise ServiceError(f"/assets/{name} does not exist: load the page anew.", code="not_found")
    packed = "gzip" in request.headers.get("accept-encoding", "")
    headers = {"Cache-Control": FOR_GOOD, "Vary": "Accept-Encoding", "X-Content-Type-Options": "nosniff"}
    if packed:
        headers["Content-Encoding"] = "gzip"
    media = mimetypes.guess_type(name)[0] or "application/octet-stream"
    return Response(_content(name, packed), media_type=media, headers=headers)


@cache
def _content(name: str, packed: bool) -> bytes:
    content = (files("kilter_service.page") / FOLDER / name).read_bytes()
    return gzip.compress(content, 9, mtime=0) if packed else content
