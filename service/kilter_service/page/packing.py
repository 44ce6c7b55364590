"""Answers of the page are sent compressed to browsers that take them so."""

from __future__ import annotations

import gzip
import io
import secrets
from contextlib import suppress

from fastapi import Request, Response
from fastapi.responses import StreamingResponse

LEAST_BYTES = 1000  # below that compressing saves no packet
LEVEL = 6
PACKED = ("text/", "application/json", "image/svg")
MOST_PADDING = 100  # bytes


def compress_response(request: Request, response: Response) -> Response:
    """Compress a text in place where the browser takes gzip; streams, files, short and empty answers stay as they are."""
    media = response.headers.get("content-type", "")
    if isinstance(response, StreamingResponse) or not media.startswith(PACKED):
        return response
    response.headers.add_vary_header("Accept-Encoding")
    body = bytes(getattr(response, "body", b""))
    if len(body) < LEAST_BYTES or "content-encoding" in response.headers or not takes_gzip(request):
        return response
    response.body = _gzip(body)
    response.headers["Content-Encoding"] = "gzip"
    response.headers["Content-Length"] = str(len(response.body))
    return response


def takes_gzip(request: Request) -> bool:
    """Whether the browser says that it takes gzip, and not that it refuses it (``gzip;q=0``)."""
    for one in request.headers.get("accept-encoding", "").lower().split(","):
        name, _, weight = one.replace(" ", "").partition(";q=")
        if name == "gzip":
            with suppress(ValueError):
                return float(weight or "1") > 0
    return False


def _gzip(body: bytes) -> bytes:
    """Compress, with a file name of random length in front: the size tells nobody what the page repeats (BREACH)."""
    out = io.BytesIO()
    padding = "a" * secrets.randbelow(MOST_PADDING)
    with gzip.GzipFile(padding, "wb", LEVEL, out, mtime=0) as file:
        file.write(body)
    return out.getvalue()
