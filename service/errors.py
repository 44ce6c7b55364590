"""One table from error code to HTTP status, and RFC 9457 problem documents for whatever goes wrong."""

from __future__ import annotations

import json
import logging
import uuid
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from core.errors import CoreError

log = logging.getLogger("kilter.api")

MEDIA_TYPE = "application/problem+json"

# 400 is the status of a code that is not listed: data that cannot be calibrated.
PROBLEMS: Mapping[str, tuple[int, str]] = {
    "robot_invalid": (400, "The robot description cannot be a serial arm"),
    "observations_invalid": (400, "The measurements cannot be what their columns say"),
    "option_invalid": (400, "An option does not exist or does not fit"),
    "too_few_poses": (400, "Too few poses"),
    "not_converged": (400, "The estimator found no minimum"),
    "kind_unavailable": (400, "This kind of job does not exist"),
    "export_unavailable": (400, "This export format does not exist"),
    "campaigns_invalid": (400, "The campaigns do not fit the job"),
    "upload_incomplete": (400, "The upload broke off"),
    "token_missing": (401, "A token is needed"),
    "token_wrong": (401, "The token is not this server's"),
    "not_found": (404, "There is nothing at this address"),
    "robot_not_found": (404, "Unknown robot"),
    "campaign_not_found": (404, "Unknown campaign"),
    "job_not_found": (404, "Unknown job"),
    "version_not_found": (404, "Unknown parameter version"),
    "binding_refused": (400, "This address may not be listened on"),
    "token_file_open": (400, "The token file can be read by others"),
    "method_not_allowed": (405, "This address does not take that method"),
    "robot_exists": (409, "The robot's name is taken"),
    "robot_in_use": (409, "The robot is in use"),
    "cancelled": (409, "The job was cancelled"),
    "job_finished": (409, "The job has already finished"),
    "no_active_version": (409, "The robot has no active version"),
    "nothing_to_roll_back": (409, "There is no earlier version to return to"),
    "upload_too_large": (413, "The upload is too large"),
    "media_type_unsupported": (415, "This media type is not read"),
    "payload_invalid": (422, "The payload does not have the right shape"),
    "internal_error": (500, "Kilter failed"),
    "not_ready": (503, "Kilter is not ready"),
    "database_outdated": (503, "The database is not of this version of Kilter"),
}


class ServiceError(CoreError):
    """A refusal of the service; its code is a key of the problem table."""

    default_code = "internal_error"


class Problem(BaseModel):
    """What every error looks like (RFC 9457): ``code`` is stable, ``detail`` names the place and the remedy."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    context: dict[str, Any]
    request_id: str


# For the OpenAPI document: the answers every route may give besides its own.
RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": "Problem document"} for status in ("4XX", 422, "5XX")
}


def new_request_id() -> str:
    """Return the identifier that ties a response to the server's log."""
    return uuid.uuid4().hex[:16]


def plain(value: Any) -> Any:
    """Return what JSON can say of a value in an error's context (arrays, numpy numbers, paths)."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def problem(
    request: Request, code: str, detail: str, context: Mapping[str, Any], status: int | None = None
) -> Response:
    """Build the problem document of ``code``; ``status`` overrides the table's."""
    listed, title = PROBLEMS.get(code, (400, "The request cannot be fulfilled"))
    status = status or listed
    document = {
        "type": f"urn:kilter:problem:{code}",
        "title": title,
        "status": status,
        "detail": detail,
        "code": code,
        "context": dict(context),
        "request_id": getattr(request.state, "request_id", new_request_id()),
    }
    headers = {"WWW-Authenticate": "Bearer"} if status == 401 else None
    return Response(json.dumps(document, default=plain), status, headers, MEDIA_TYPE)


async def on_core_error(request: Request, error: Exception) -> Response:
    """Turn an error of core or of the service into its problem document."""
    assert isinstance(error, CoreError)
    return problem(request, error.code, error.message, error.context)


async def on_validation_error(request: Request, error: Exception) -> Response:
    """Turn a payload of the wrong shape into a 422 that names every place."""
    assert isinstance(error, RequestValidationError)
    places = [
        {"place": ".".join(str(part) for part in item["loc"]), "message": item["msg"], "type": item["type"]}
        for item in error.errors()
    ]
    detail = "; ".join(f"{item['place']}: {item['message']}" for item in places)
    return problem(request, "payload_invalid", detail, {"errors": places})


async def on_http_error(request: Request, error: Exception) -> Response:
    """Turn what the framework refuses (unknown address, wrong method) into a problem document."""
    assert isinstance(error, HTTPException)
    if error.status_code == 404:
        return problem(request, "not_found", f"{request.url.path} does not exist: see /docs.", {})
    if error.status_code == 405:
        return problem(request, "method_not_allowed", f"{request.url.path} does not take {request.method}.", {})
    return problem(request, "payload_invalid", str(error.detail), {}, error.status_code)


class RequestNaming:
    """Give every request its identifier, and turn an unexpected exception into a 500 that leaks nothing."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request_id = new_request_id()
        scope.setdefault("state", {})["request_id"] = request_id
        started = False

        async def send_named(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                message["headers"] = [*message["headers"], (b"x-request-id", request_id.encode())]
            await send(message)

        try:
            await self.app(scope, receive, send_named)
        except Exception:
            log.exception("request %s %s %s failed", request_id, scope["method"], scope["path"])
            if started:
                raise
            detail = f"Kilter failed. The server's log has the cause under request {request_id}."
            await problem(Request(scope), "internal_error", detail, {})(scope, receive, send_named)


def install(app: FastAPI) -> None:
    """Make every answer of ``app`` that is an error a problem document."""
    app.add_exception_handler(CoreError, on_core_error)
    app.add_exception_handler(RequestValidationError, on_validation_error)
    app.add_exception_handler(HTTPException, on_http_error)
    app.add_middleware(RequestNaming)
