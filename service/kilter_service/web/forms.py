"""A body of two parts, ``multipart/form-data``: a document, and the file that it describes."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import AsyncGenerator
from pathlib import Path

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from kilter_service.ground.errors import ServiceError
from kilter_service.web.bodies import UPLOAD, iter_body_chunks

FORM = "multipart/form-data"


def is_form(request: Request) -> bool:
    """Whether the body says that it has parts."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower() == FORM


async def spool_form(
    request: Request, path: Path, names: tuple[str, str], limits_mb: tuple[int, int]
) -> tuple[bytes, str, str]:
    """Write the file to ``path``; return the document, the media type of the file, and the SHA-256 of the whole body.

    ``names`` are those of the document and of the file, ``limits_mb`` how large the document and the whole may be.

    Raises:
        ServiceError: the body is larger than the limit, packed, broken off, or has not these two parts.

    """
    digest = hashlib.sha256()

    async def iter_hashed_chunks() -> AsyncGenerator[bytes, None]:
        async for piece in iter_body_chunks(request, limits_mb[1], UPLOAD):
            digest.update(piece)
            yield piece

    parser = MultiPartParser(
        request.headers,
        iter_hashed_chunks(),
        max_files=1,
        max_fields=1,
        max_part_size=limits_mb[0] << 20,
    )
    try:
        form = await parser.parse()
    except (MultiPartException, KeyError, UnicodeError) as error:
        raise ServiceError(
            f"The body is not a form of the parts {names[0]} and {names[1]}: {error}.", code="payload_invalid"
        ) from error
    try:
        document, file = (form.get(name) for name in names)
        if not isinstance(document, str) or not isinstance(file, UploadFile):
            raise ServiceError(
                f"The form must have {names[0]}, JSON without a filename, and {names[1]}, a file with its Content-Type.",
                code="payload_invalid",
            )
        await run_in_threadpool(_copy_upload, file, path)
        return document.encode(), file.content_type or "", digest.hexdigest()
    finally:
        await form.close()


def _copy_upload(file: UploadFile, path: Path) -> None:
    with path.open("wb") as to:
        shutil.copyfileobj(file.file, to)
