"""The two gates of a route: the token for what changes or computes, `reader` for what is open on loopback only."""

from __future__ import annotations

import secrets
from typing import Annotated

from fastapi import Depends, Request

from kilter_service.errors import ServiceError

ADMIN = "admin"
PLAIN_READS = frozenset({"GET", "HEAD"})


def admin(request: Request) -> str:
    """Let in whoever has the admin token; returns who it is, for the log of changes.

    Raises:
        ServiceError: no token, or another one.

    """
    scheme, _, given = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer" or not given:
        raise ServiceError(
            "This needs the admin token: send `Authorization: Bearer ...` with the content of the `token` file in "
            "the server's data folder (the client does so when KILTER_TOKEN is set or it runs on the same machine).",
            code="token_missing",
        )
    if not secrets.compare_digest(given.strip().encode(), request.app.state.token.encode()):
        raise ServiceError(
            "The token is not this server's: compare it with the `token` file in the server's data folder.",
            code="token_wrong",
        )
    return ADMIN


def changes(request: Request) -> bool:
    """Whether a request is more than a plain read: it changes something, or computes from what it sends."""
    return request.method not in PLAIN_READS


def reader(request: Request) -> None:
    """Let everybody read on loopback, and only the admin token elsewhere."""
    if not request.app.state.settings.is_loopback:
        admin(request)


Admin = Annotated[str, Depends(admin)]
