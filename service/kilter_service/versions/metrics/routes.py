"""Metrics over HTTP."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from kilter_service.versions.metrics import service
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(tags=["health"], route_class=GuardedRoute)
TEXT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Metrics"}
}


@router.get("/metrics", response_class=Response, responses=TEXT)
def metrics(database: DatabaseOfApp, settings: SettingsOfApp) -> Response:
    """Return the metrics of this process and of the database, in the text format of Prometheus."""
    return Response(service.text(database, settings), headers={"Content-Type": service.MEDIA_TYPE})
