"""RFC 9457 problem documents for whatever goes wrong in a request."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Mapping
from html import escape
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kilter_core.errors import CoreError
from kilter_service.contract.server import Problem
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.errors import PROBLEMS
from kilter_service.web import audit
from kilter_service.web.request_log import REFUSALS, new_request_id

log = logging.getLogger("kilter.api")

MEDIA_TYPE = "application/problem+json"
# A refusal does not grow with what was sent.
MOST_DETAIL, MOST_PLACES, MOST_PLACE, MOST_CONTEXT = 4000, 20, 100, 20_000
RETRY_AFTER_S = 1
STOPPING = (
    "The server is stopping and could not finish this. A change may have been made: look, or send it again, with the "
    "same Idempotency-Key where it takes one."
)


def declare_problem_media_type(document: dict[str, Any]) -> dict[str, Any]:
    """Say in an OpenAPI document that refusals have the media type they are sent as: FastAPI gives them the answer's."""
    for methods in document["paths"].values():
        for operation in methods.values():
            for answer in operation["responses"].values():
                content = answer.get("content", {})
                for media in [media for media, what in content.items() if _is_problem(what)]:
                    content[MEDIA_TYPE] = content.pop(media)
    return document


def _is_problem(content: Mapping[str, Any]) -> bool:
    return str(content.get("schema", {}).get("$ref", "")).endswith(f"/{Problem.__name__}")


def json_default(value: Any) -> Any:
    """Return what JSON can say of a value in an error's context (arrays, numpy numbers, paths)."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def problem(
    request: Request, code: str, detail: str, context: Mapping[str, Any], status: int | None = None
) -> Response:
    """Build the problem document of ``code``; ``status`` overrides the table's."""
    listed, title = PROBLEMS.get(code, (400, "The request cannot be fulfilled"))
    status = status or listed
    REFUSALS.labels(code).inc()
    audit.note(request, code)
    if request.headers.get("hx-request") == "true":
        return _render_problem_part(code, title, detail, status, refusal_headers(code, status, context))
    if _reads(request):
        return _page(request, code, title, detail, status, refusal_headers(code, status, context))
    document = {
        "type": f"urn:kilter:problem:{code}",
        "title": title,
        "status": status,
        "detail": detail if len(detail) <= MOST_DETAIL else f"{detail[:MOST_DETAIL]}...",
        "code": code,
        "context": _drop_long_values(context),
        "request_id": getattr(request.state, "request_id", new_request_id()),
    }
    return Response(
        json.dumps(document, default=json_default), status, refusal_headers(code, status, context), MEDIA_TYPE
    )


def _render_problem_part(code: str, title: str, detail: str, status: int, headers: dict[str, str] | None) -> Response:
    """What a person reads where a part of a page was to stand: the page itself says the refusals that its views know."""
    told = f"<strong>{escape(title)}.</strong> {escape(detail[:MOST_DETAIL])}"
    text = (
        f'<div class="note bad" role="alert" data-code="{escape(code)}">{told} Close this, or load the page anew.</div>'
    )
    return Response(text, status, headers, "text/html; charset=utf-8")


def _reads(request: Request) -> bool:
    """Whether a person opened this address in a browser; the interface below /v1 answers everybody alike."""
    return "text/html" in request.headers.get("accept", "") and not request.url.path.startswith("/v1")


def _page(
    request: Request, code: str, title: str, detail: str, status: int, headers: dict[str, str] | None
) -> Response:
    """What a person reads where no view answers: an address that there is not, or a server that has no time."""
    root = escape(request.scope.get("root_path", ""))
    text = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, '
        f'initial-scale=1"><title>{escape(title)} · Kilter</title></head><body><main><h1>{escape(title)}</h1>'
        f'<p role="alert" data-code="{escape(code)}">{escape(detail[:MOST_DETAIL])}</p>'
        f'<p><a href="{root}/">To the robots</a></p></main></body></html>'
    )
    return Response(text, status, headers, "text/html; charset=utf-8")


def _drop_long_values(context: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out what a refusal would only repeat."""
    return {
        key: value for key, value in context.items() if len(json.dumps(value, default=json_default)) <= MOST_CONTEXT
    }


def refusal_headers(code: str, status: int, context: Mapping[str, Any]) -> dict[str, str] | None:
    """Return the headers that a refusal has: how to log in, or when to come again."""
    if status == 401:
        return {"WWW-Authenticate": "Bearer"}
    if code in ("busy", "database_away", "stopping") or "retry_after_s" in context:
        again = {"Retry-After": str(context.get("retry_after_s", RETRY_AFTER_S))}
        return again | {"Connection": "close"} if status == 408 else again  # what is left of its body is not read
    return None


async def on_core_error(request: Request, error: Exception) -> Response:
    """Convert an error of core or of the service to its problem document."""
    assert isinstance(error, CoreError)
    return problem(request, error.code, error.message, error.context)


async def on_validation_error(request: Request, error: Exception) -> Response:
    """Answer a payload of the wrong shape with a 422 that names every place."""
    assert isinstance(error, RequestValidationError)
    found = error.errors()
    places = [
        {
            "place": ".".join(str(part)[:MOST_PLACE] for part in item["loc"]),
            "message": item["msg"],
            "type": item["type"],
        }
        for item in found[:MOST_PLACES]
    ]
    detail = "; ".join(f"{item['place']}: {item['message']}" for item in places)
    if len(found) > len(places):
        detail += f"; and {len(found) - len(places)} more"
    return problem(request, "payload_invalid", detail, {"errors": places})


async def on_http_error(request: Request, error: Exception) -> Response:
    """Convert what the framework refuses (unknown address, wrong method) to a problem document."""
    assert isinstance(error, HTTPException)
    if error.status_code == 404:
        return problem(request, "not_found", f"{request.url.path} does not exist: see /docs.", {})
    if error.status_code == 405:
        return problem(request, "method_not_allowed", f"{request.url.path} does not take {request.method}.", {})
    return problem(request, "payload_invalid", str(error.detail), {}, error.status_code)


class RequestNaming:
    """Give every request its identifier, and answer an unexpected exception with a 500 that leaks nothing."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request_id = scope.setdefault("state", {}).setdefault("request_id", new_request_id())
        started = False

        async def send_named(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                message["headers"] = [*message["headers"], (b"x-request-id", request_id.encode())]
            await send(message)

        try:
            await self.app(scope, receive, send_named)
        except asyncio.CancelledError:
            if started:
                raise
            # The server stops and waits no longer. What is left of the task is this answer.
            _uncancel_current_task()
            await problem(Request(scope), "stopping", STOPPING, {})(scope, receive, send_named)
        except Exception as error:
            known = in_words(error)
            if known is not None and not started:
                log.error("request %s %s %s: %s", request_id, scope["method"], scope["path"], known.message)
                await problem(Request(scope), known.code, known.message, known.context)(scope, receive, send_named)
                return
            log.exception("request %s %s %s failed", request_id, scope["method"], scope["path"])
            if started:
                raise
            detail = f"Kilter failed. The server's log has the cause under request {request_id}."
            await problem(Request(scope), "internal_error", detail, {})(scope, receive, send_named)


def _uncancel_current_task() -> None:
    task = asyncio.current_task()
    if task is not None:
        task.uncancel()


def install(app: FastAPI) -> None:
    """Make every answer of ``app`` that is an error a problem document."""
    app.add_exception_handler(CoreError, on_core_error)
    app.add_exception_handler(RequestValidationError, on_validation_error)
    app.add_exception_handler(HTTPException, on_http_error)
    app.add_middleware(RequestNaming)
    described = app.openapi

    def openapi() -> dict[str, Any]:
        return app.openapi_schema or declare_problem_media_type(described())

    app.openapi = openapi  # type: ignore[method-assign]  # as FastAPI says that it is to be extended
