"""Answers that a client may keep: each has an ETag, and one that the client has already is not sent again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from fastapi import Request, Response

from kilter_service.web.routing import GuardedRoute

# Only its own reader may keep an answer, and asks each time whether it still holds: people rename and retire things.
ASK_AGAIN = "private, no-cache"
FOR_GOOD = "private, max-age=31536000, immutable"  # of what nothing changes any more
NOT_CHANGED = {304: {"description": "`If-None-Match` names what would be sent: it is not sent again"}}


class ConditionalRoute(GuardedRoute):
    """A route whose plain reads have an ETag, made from what they say, and honour `If-None-Match`."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **more: Any) -> None:
        if more.get("methods") == ["GET"]:
            more["responses"] = {**NOT_CHANGED, **(more.get("responses") or {})}
        super().__init__(path, endpoint, **more)

    def get_route_handler(self) -> Callable[[Request], Any]:
        """Return what answers a request."""
        answer = super().get_route_handler()

        async def handle(request: Request) -> Response:
            response: Response = await answer(request)
            if request.method == "GET" and response.status_code == 200 and hasattr(response, "body"):
                return _conditional(request, response)
            return response

        return handle


def _conditional(request: Request, response: Response) -> Response:
    # An endpoint that knows the state behind its answer has named it already: `If-Match` names that state.
    tag = response.headers.get("etag") or f'"{hashlib.blake2s(bytes(response.body), digest_size=16).hexdigest()}"'
    response.headers["ETag"] = tag
    response.headers.setdefault("Cache-Control", ASK_AGAIN)
    if not _has_matching_etag(request.headers.get("if-none-match", ""), tag):
        return response
    kept = {name: response.headers[name] for name in ("ETag", "Cache-Control")}
    return Response(status_code=304, headers=kept)


def _has_matching_etag(header: str, tag: str) -> bool:
    """Whether a list of ETags has this one; a weak one counts, as RFC 9110 wants of a read."""
    named = [one.strip().removeprefix("W/") for one in header.split(",")]
    return tag in named or named == ["*"]
