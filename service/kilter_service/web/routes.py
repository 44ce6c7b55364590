"""The audit, tokens and health over HTTP; health is open to everybody, for what watches a server has no token.

`/docs` is the description of the HTTP interface to read and to try, without internet and without inline script.

The page that FastAPI makes loads Swagger UI from a host on the internet and starts it from a script in the page. Servers
run in halls without internet, and no foreign script should run beside a page that can set the arm in motion.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse

from kilter_service.contract.server import (
    AuditPage,
    Health,
    Identity,
    LoginLink,
    MadeToken,
    NewLoginLink,
    NewToken,
    Token,
    TokenList,
)
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.memory import return_freed_memory
from kilter_service.ground.settings import code_version
from kilter_service.web import audit, logins
from kilter_service.web import health as health_service
from kilter_service.web.auth.access import Admin, get_caller
from kilter_service.web.auth.policy import rule_for_route
from kilter_service.web.routing import DatabaseOfApp, GuardedRoute, PageOfList, SettingsOfApp

router = APIRouter(prefix="/v1", tags=["access"], route_class=GuardedRoute)


@router.get("/audit")
def listed(database: DatabaseOfApp, page: PageOfList) -> AuditPage:
    """List who changed what, from where, before and after, oldest first; at most 1000 entries at once."""
    return audit.list_entries(database, page)


token_router = APIRouter(prefix="/v1", tags=["access"], route_class=GuardedRoute)


@token_router.get("/whoami")
def whoami(request: Request) -> Identity:
    """Say who sends this request, in which role, and for which robots."""
    caller = get_caller(request)
    robots = None if caller.robots is None else sorted(caller.robots)
    return Identity(actor=caller.actor, token_id=caller.token_id, role=caller.role, robots=robots)


@token_router.post("/tokens", status_code=201)
def add(wanted: NewToken, response: Response, database: DatabaseOfApp, actor: Admin) -> MadeToken:
    """Make a token; what to send with requests is shown this once only."""
    response.headers["Cache-Control"] = "no-store"
    return logins.add(database, wanted, actor)


@token_router.post("/login-links", status_code=201)
def link(wanted: NewLoginLink, request: Request, response: Response, database: DatabaseOfApp) -> LoginLink:
    """Make a link that logs a browser in once, in the role of whoever asks; its secret is in this answer and nowhere else."""
    response.headers["Cache-Control"] = "no-store"
    secret, until = logins.link(database, request.state.credentials.token_sha256, wanted.minutes)
    return LoginLink(path=f"/login#{secret}", expires_at=until)


@token_router.get("/tokens")
def list_tokens(database: DatabaseOfApp, page: PageOfList) -> TokenList:
    """List the tokens, newest first; also those that expired or were revoked."""
    return logins.list_tokens(database, page)


@token_router.delete("/tokens/{token}")
def revoke(token: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin) -> Token:
    """End a token at once, and the sessions of streams that it asked for; a repeat changes nothing."""
    ended = logins.revoke(database, token, actor)
    request.app.state.end_sessions(database, settings, ended.id)  # handed in: the stream is above
    return ended


health_router = APIRouter(prefix="/v1/health", tags=["health"], route_class=GuardedRoute)


@health_router.get("")
async def health(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> Health:
    """Report the state of the server: database, disk, worker, corrector, ROS 2 adaptor."""
    return await to_thread.run_sync(health_service.report, database, settings, limiter=request.app.state.health_threads)


@health_router.get("/live")
async def live() -> Health:  # waits for no thread, whatever the others do
    """Answer that the API process lives."""
    return Health(status="live", version=code_version(), checks={})


@health_router.get("/ready")
async def ready(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> Health:
    """Answer 200 when every part that should run does, else 503 with the cause."""
    report = await health(request, database, settings)
    if report.status != "ready":
        causes = "; ".join(f"{name}: {check.detail}" for name, check in report.checks.items() if not check.ok)
        raise ServiceError(causes, code="not_ready", checks={n: c.model_dump() for n, c in report.checks.items()})
    return report


SCHEME = "token"
ROLE = "x-kilter-role"
WORDS = (
    "A token of this server. A higher role (viewer, operator, admin) may do what a lower one may. Where no token is an "
    "alternative, plain reads need none on the server's own machine."
)


def openapi_with_security(app: FastAPI) -> Callable[[], dict[str, Any]]:
    """Return what makes the description of an application, with its tokens."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        document = plain()
        schemes = document["components"].setdefault("securitySchemes", {})
        schemes[SCHEME] = {"type": "http", "scheme": "bearer", "description": WORDS}
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                _describe(operation, f"{method.upper()} {path}")
        return document

    return openapi


def serve_openapi(app: FastAPI) -> None:
    """Answer ``/openapi.json`` from its text: as objects, which FastAPI keeps, the description takes 20 MB."""

    @cache
    def text() -> bytes:
        made = bytes(JSONResponse(app.openapi()).body)
        app.openapi_schema = None
        return_freed_memory()
        return made

    async def answer(request: Request) -> Response:
        made, root = await run_in_threadpool(text), request.scope.get("root_path", "").rstrip("/")
        if root:  # as FastAPI says where a proxy shows the server
            made = bytes(JSONResponse({**json.loads(made), "servers": [{"url": root}]}).body)
        return Response(made, media_type=JSONResponse.media_type)

    app.add_route("/openapi.json", answer, include_in_schema=False)


def _describe(operation: dict[str, Any], route: str) -> None:
    rule = rule_for_route(route)
    if rule.role is None:
        operation["security"] = []
        return
    operation[ROLE] = rule.role
    direct = rule.role == "viewer" and route.startswith("GET ")
    operation["security"] = [{SCHEME: []}, {}] if direct else [{SCHEME: []}]


docs_router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

# Swagger UI's style sheet holds two arrows as data: addresses; everything else comes from this server.
POLICY = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
FILES = {"swagger-ui.css": "text/css", "swagger-ui-bundle.js": "text/javascript"}

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="{root}/docs/swagger-ui.css">
</head>
<body>
<div id="swagger-ui"></div>
<noscript>This page needs JavaScript. The description itself is at <a href="{root}/openapi.json">openapi.json</a>.</noscript>
<script src="{root}/docs/swagger-ui-bundle.js"></script>
<script src="{root}/docs/start.js"></script>
</body>
</html>
"""

# validatorUrl: Swagger UI would send the description to a host on the internet to have it judged.
START = """SwaggerUIBundle({{
  url: {url},
  dom_id: "#swagger-ui",
  deepLinking: true,
  validatorUrl: null,
  presets: [SwaggerUIBundle.presets.apis],
}});
"""


@docs_router.get("/docs")
def page(request: Request) -> HTMLResponse:
    """Return the page, which loads everything from this server."""
    text = PAGE.format(title=escape(request.app.title), root=escape(_root(request)))
    return HTMLResponse(text, headers={"Content-Security-Policy": POLICY})


@docs_router.get("/docs/start.js")
def start(request: Request) -> Response:
    """Return the script that starts Swagger UI."""
    return Response(START.format(url=json.dumps(f"{_root(request)}/openapi.json")), media_type="text/javascript")


@docs_router.get("/docs/{name}")
def file(name: str) -> FileResponse:
    """Return a file of Swagger UI."""
    if name not in FILES:
        raise ServiceError(f"/docs/{name} does not exist: see /docs.", code="not_found")
    return FileResponse(_folder() / name, media_type=FILES[name])


def _root(request: Request) -> str:
    """Return the path under which a proxy shows this server, empty without one."""
    return str(request.scope.get("root_path", "")).rstrip("/")


@cache
def _folder() -> Path:
    """Return where fastapi-offline keeps Swagger UI; its code, which keeps inline script, is not used."""
    spec = find_spec("fastapi_offline")
    if spec is None or spec.origin is None:
        raise FileNotFoundError("fastapi-offline is not installed: it brings the files of /docs")
    return Path(spec.origin).parent / "static"
