"""A route of the page: its answers are HTML, and so are its refusals."""

from __future__ import annotations

import gzip
import io
import logging
import secrets
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, StreamingResponse

from kilter_core.errors import CoreError
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.errors import PROBLEMS, ServiceError
from kilter_service.page.figures import room
from kilter_service.page.shell import HEADERS, get_root_path, is_part, redirect, render
from kilter_service.web.audit import refusals
from kilter_service.web.problems import headers_of
from kilter_service.web.routing import GuardedRoute

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


log = logging.getLogger("kilter.page")

Handler = Callable[[Request], Awaitable[Response]]
UNKNOWN = (400, "This cannot be done")
LOG_IN_FIRST = frozenset({"token_missing", "token_wrong", "token_ended"})


class PageRoute(GuardedRoute):
    """A route whose reader is a person in front of a browser."""

    def get_route_handler(self) -> Callable[[Request], Any]:
        """Return what answers a request."""
        answer: Handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            room.heard(
                None if "/report" in request.url.path else request.cookies.get(room.COOKIE)
            )  # a report is of paper
            try:
                response = await answer(request)
            except (CoreError, RequestValidationError) as error:
                response = render_refusal(request, error)
            except Exception as error:
                response = render_refusal(request, in_words(error) or _internal_error(request))
            for name, value in HEADERS.items():
                response.headers.setdefault(name, value)
            return compress_response(request, response)

        return handle


def _internal_error(request: Request) -> CoreError:
    """Log what nobody foresaw; whoever asked for it reads a sentence, not JSON, and the rest of the page goes on."""
    named = getattr(request.state, "request_id", "")
    log.exception("request %s %s %s failed", named, request.method, request.url.path)
    return ServiceError(
        f"This part could not be computed. The rest of the page works: close or leave it and go on. The server's log has the "
        f"cause under request {named}.",
        code="internal_error",
    )


def render_refusal(request: Request, error: CoreError | RequestValidationError) -> Response:
    """Say what is wrong: instead of the part that was asked for, or as a page. Who is not logged in is sent there."""
    if isinstance(error, RequestValidationError):
        code, message, context = "payload_invalid", "; ".join(_place(item) for item in error.errors()[:20]), {}
    else:
        code, message, context = error.code, error.message, error.context
    if code != "token_missing":  # whoever is not logged in yet is asked to, and has done nothing wrong
        refusals.note(request, code)
    if code in LOG_IN_FIRST:
        return _to_login(request)
    status, title = PROBLEMS.get(code, UNKNOWN)
    template = "refusal_part.html" if is_part(request) else "refusal.html"
    response = render(request, template, status=status, title=title, message=message, code=code)
    response.headers.update(headers_of(code, status, context) or {})
    return response


def _place(item: dict[str, Any]) -> str:
    return f"{'.'.join(str(part) for part in item['loc'][1:])}: {item['msg']}"


def _to_login(request: Request) -> Response:
    if is_part(request) or request.method != "GET":
        return redirect(request, f"{get_root_path(request)}/login")
    back = quote(f"{request.url.path}{'?' + request.url.query if request.url.query else ''}", safe="")
    return RedirectResponse(f"{get_root_path(request)}/login?then={back}", 303)
