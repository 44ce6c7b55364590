"""Health over HTTP; open to everybody, for what watches a server has no token."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request

from kilter_service.contract.health import Health
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.version import code_version
from kilter_service.web.health import service
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp

router = APIRouter(prefix="/v1/health", tags=["health"], route_class=GuardedRoute)


@router.get("")
async def health(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> Health:
    """Report the state of the server: database, disk, worker, corrector, ROS 2 adaptor."""
    return await to_thread.run_sync(service.report, database, settings, limiter=request.app.state.health_threads)


@router.get("/live")
async def live() -> Health:  # waits for no thread, whatever the others do
    """Answer that the API process lives."""
    return Health(status="live", version=code_version(), checks={})


@router.get("/ready")
async def ready(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> Health:
    """Answer 200 when every part that should run does, else 503 with the cause."""
    report = await health(request, database, settings)
    if report.status != "ready":
        causes = "; ".join(f"{name}: {check.detail}" for name, check in report.checks.items() if not check.ok)
        raise ServiceError(causes, code="not_ready", checks={n: c.model_dump() for n, c in report.checks.items()})
    return report
