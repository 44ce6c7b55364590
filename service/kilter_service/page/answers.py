"""How the page answers: templates and what they may call, scripts and styles under their hash, refusals as HTML."""

from __future__ import annotations

import gzip
import io
import json
import logging
import mimetypes
import secrets
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, RedirectResponse, StreamingResponse
from jinja2 import Environment, PackageLoader, StrictUndefined

from kilter_core.errors import CoreError
from kilter_service.contract.server import Role
from kilter_service.ground.caller import ANYBODY, CALLER, RANK
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.errors import PROBLEMS, ServiceError
from kilter_service.ground.settings import code_version
from kilter_service.page import words
from kilter_service.page.figures import plot as room
from kilter_service.web import audit, logins
from kilter_service.web.problems import refusal_headers
from kilter_service.web.routing import FOR_GOOD, GuardedRoute

assets = APIRouter(include_in_schema=False, route_class=GuardedRoute)
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


@assets.get("/assets/{name}")
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


# No inline script or style, no eval, nothing of another host; nobody may show the page within a page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "font-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
WHOLE = ("{% extends", "<!DOCTYPE")  # how the template of a whole page begins
MACROS = {  # what every template may call, and those below them
    "parts": "parts.html",
    "lists": "lists.html",
    "buttons": "steps.html",
    "measured_rows": "rows.html",
    "suspicious_rows": "suspicious.html",
    "masses": "masses.html",
    "torques": "torques.html",
    "goals": "robot/goals.html",
    "job_table": "job_list/table.html",
    "table_of": "jobs/uses.html",
    "remarks": "jobs/remarks.html",
    "shown_parts": "versions/parts.html",
    "changes": "versions/changes.html",
    "pairs": "versions/pairs.html",
}
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",  # measurements stay out of the browser's cache
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
}


def render(request: Request, template: str, status: int = 200, **shown: Any) -> HTMLResponse:
    """Fill a template, which extends ``base.html`` or is a part of a page; a part that is opened alone becomes a page."""
    alone = _is_part_of_a_page(template) and not is_part(request)
    filled = environment().get_template("alone.html" if alone else template)
    text = filled.render(**shared_context(request), **shown, **({"part": template} if alone else {}))
    return HTMLResponse(text, status, HEADERS)


@cache
def _is_part_of_a_page(template: str) -> bool:
    loader = environment().loader
    return loader is not None and not loader.get_source(environment(), template)[0].lstrip().startswith(WHOLE)


def shared_context(request: Request) -> dict[str, Any]:
    """Return what every template may use."""
    kept = request.cookies.get(logins.COOKIE, "")
    caller = CALLER.get()
    return {
        "root": get_root_path(request),
        "path": request.url.path,
        "asset": lambda name: f"{get_root_path(request)}/assets/{hashed_file_name(name)}",
        "actor": "" if caller is None or caller.actor == ANYBODY else caller.actor,
        "role": "" if caller is None else caller.role,
        "may": may,
        "csrf": logins.csrf_token(kept) if kept else "",
        "version_of_kilter": code_version(),
    }


def may(role: Role) -> bool:
    """Whether whoever looks at the page has this role; a template disables what they may not."""
    caller = CALLER.get()
    return caller is not None and RANK[caller.role] >= RANK[role]


@cache
def environment() -> Environment:
    """Return the templates. What they are not given is an error; everything they show is escaped."""
    loaded = Environment(
        loader=PackageLoader("kilter_service.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    loaded.filters.update(words.FILTERS)
    for name, template in MACROS.items():  # each may call those before it
        loaded.globals[name] = loaded.get_template(template).module
    return loaded


def source(name: str) -> str:
    """Return a style sheet as it was written, for a document that is not read in a browser."""
    return (files("kilter_service.page") / "sources" / name).read_text(encoding="utf-8")


def get_root_path(request: Request) -> str:
    """Return the path under which a proxy shows this server, empty without one."""
    return str(request.scope.get("root_path", "")).rstrip("/")


def is_part(request: Request) -> bool:
    """Whether htmx asks for a part of a page."""
    return request.headers.get("hx-request") == "true"


def redirect(request: Request, address: str) -> Response:
    """Send the browser to a page of this server, whether it asked for a page or for a part of one."""
    address = get_root_path(request) + address
    if is_part(request):
        return Response(status_code=204, headers={"HX-Redirect": address})
    return RedirectResponse(address, 303)


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
        code, message, context = "payload_invalid", words.validation_words(error, 1, 20), {}
    else:
        code, message, context = error.code, error.message, error.context
    if code != "token_missing":  # whoever is not logged in yet is asked to, and has done nothing wrong
        audit.note(request, code)
    if code in LOG_IN_FIRST:
        return _to_login(request)
    status, title = PROBLEMS.get(code, UNKNOWN)
    template = "refusal_part.html" if is_part(request) else "refusal.html"
    response = render(request, template, status=status, title=title, message=message, code=code)
    response.headers.update(refusal_headers(code, status, context) or {})
    return response


def _to_login(request: Request) -> Response:
    if is_part(request) or request.method != "GET":
        return redirect(request, "/login")
    back = quote(f"{request.url.path}{'?' + request.url.query if request.url.query else ''}", safe="")
    return RedirectResponse(f"{get_root_path(request)}/login?then={back}", 303)


router = APIRouter(include_in_schema=False, route_class=PageRoute)  # of all views
