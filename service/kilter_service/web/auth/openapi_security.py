"""What OpenAPI says of tokens: the scheme, and for each route whether it needs one, of which role."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import JSONResponse

from kilter_service.ground.processes.memory import return_freed_memory
from kilter_service.web.auth.policy import rule_for_route

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
