"""A request's body into a file, hashed on the way."""

from __future__ import annotations

import hashlib
from pathlib import Path

from fastapi import Request
from starlette.requests import ClientDisconnect

from service.errors import ServiceError


async def receive(request: Request, path: Path, limit_mb: int) -> str:
    """Write the body to ``path`` and return its SHA-256.

    Raises:
        ServiceError: the body is larger than the limit, or it broke off.

    """
    limit = limit_mb << 20
    digest, size = hashlib.sha256(), 0
    try:
        with path.open("wb") as file:
            async for part in request.stream():
                size += len(part)
                if size > limit:
                    raise ServiceError(
                        f"The upload is larger than {limit_mb} MB: split it, or raise KILTER_MAX_UPLOAD_MB.",
                        code="upload_too_large",
                        limit_mb=limit_mb,
                    )
                digest.update(part)
                file.write(part)
    except ClientDisconnect as error:
        raise ServiceError("The upload broke off; nothing was stored.", code="upload_incomplete") from error
    return digest.hexdigest()
