"""The HTTP application.

How what a path names is looked up, for tokens that are limited to robots.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager

from anyio import CapacityLimiter
from fastapi import APIRouter, FastAPI
from fastapi.concurrency import run_in_threadpool

from kilter_service.campaigns import store as campaign_rows
from kilter_service.campaigns.routes import router as campaigns
from kilter_service.campaigns.routes import suspicious_router as suspicious
from kilter_service.correction.routes import router as correction
from kilter_service.correction.routes import torque_router as torques
from kilter_service.ground.db import Database, Session, revision
from kilter_service.ground.private_files import TEMPORARY, Scratch
from kilter_service.ground.settings import Settings, code_version
from kilter_service.ground.store import NOMINAL
from kilter_service.jobs import store as job_rows
from kilter_service.jobs.fleet import store as fleet_rows
from kilter_service.jobs.routes import fleet_router as fleet_jobs
from kilter_service.jobs.routes import router as jobs
from kilter_service.kept.routes import router as references
from kilter_service.page.drop.drafts import Drafts
from kilter_service.page.routes import ROUTERS as PAGE
from kilter_service.robots import store as robot_rows
from kilter_service.robots.routes import frame_router as frames
from kilter_service.robots.routes import instrument_router as instruments
from kilter_service.robots.routes import mesh_router as meshes
from kilter_service.robots.routes import repair_router as repairs
from kilter_service.robots.routes import router as robots
from kilter_service.stream.live.followers import get_viewers
from kilter_service.stream.routes import router as bridges
from kilter_service.stream.routes import session_router as streams
from kilter_service.stream.signing.service import end_sessions
from kilter_service.versions import store as version_rows
from kilter_service.versions.routes import acceptance_router as acceptance
from kilter_service.versions.routes import drift_router as drift
from kilter_service.versions.routes import metrics_router as metrics
from kilter_service.versions.routes import router as versions
from kilter_service.versions.routes import today_router as today
from kilter_service.web import problems
from kilter_service.web.audit import Refusals
from kilter_service.web.auth.token import admin_token
from kilter_service.web.bodies import rooms_by_kind
from kilter_service.web.gate import Gate, Rates, Unhurried
from kilter_service.web.request_log import Observed
from kilter_service.web.routes import docs_router as docs_page
from kilter_service.web.routes import health_router as health
from kilter_service.web.routes import openapi_with_security, serve_openapi
from kilter_service.web.routes import router as audit
from kilter_service.web.routes import token_router as tokens

SUMMARY = "Keeps a serial robot arm accurate: it identifies its errors from measured poses and corrects its setpoints."

ROUTERS: tuple[APIRouter, ...] = (
    robots,
    today,
    drift,
    meshes,
    campaigns,
    suspicious,
    versions,
    jobs,
    torques,
    fleet_jobs,
    correction,
    frames,
    references,
    streams,
    bridges,
    tokens,
    audit,
    metrics,
    instruments,
    acceptance,
    repairs,
)
HEALTH_THREADS = 4  # of its own: those of the other routes may all wait for a database that hangs


def create_app(settings: Settings) -> FastAPI:
    """Build the application; nothing is opened before it starts."""
    app = FastAPI(
        title="Kilter",
        version=code_version(),
        summary=SUMMARY,
        lifespan=lambda app: _life(app, settings),
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
    )
    app.state.rooms = rooms_by_kind(settings)
    app.state.rates = Rates(settings.rate)
    app.state.look_up = look_up
    app.state.end_sessions = end_sessions
    app.add_middleware(Unhurried)
    app.add_middleware(Gate, settings=settings)
    problems.install(app)
    app.add_middleware(Observed)
    # The routes themselves: FastAPI would build each of an included router anew, 0.3 s at the first requests.
    for router in (health, docs_page, *ROUTERS, *PAGE):  # the first that fits is found by looking at each
        app.router.routes.extend(router.routes)
    app.openapi = openapi_with_security(app)  # type: ignore[method-assign]  # as FastAPI says to extend it
    serve_openapi(app)
    return app


@asynccontextmanager
async def _life(app: FastAPI, settings: Settings) -> AsyncIterator[None]:
    app.state.settings = settings
    app.state.token = admin_token(settings)
    app.state.database = Database(settings.database)
    app.state.refusals = Refusals(app.state.database)
    app.state.health_threads = CapacityLimiter(HEALTH_THREADS)
    app.state.scratch = Scratch(settings.data / TEMPORARY)
    app.state.drafts = Drafts(app.state.scratch)
    try:
        revision.check(app.state.database)
        yield
    finally:
        await get_viewers(app).close()
        app.state.scratch.close()
        await run_in_threadpool(app.state.refusals.close)
        app.state.database.close()


LOOKED_UP: Mapping[str, Callable[[Session, str], object]] = {
    "robot": robot_rows.get,
    "campaign": campaign_rows.get,
    "version": version_rows.get,
    "a": version_rows.get,
    "b": version_rows.get,
    "job": job_rows.get,
    "fleet_job": fleet_rows.get,
}


def look_up(session: Session, name: str, value: str) -> None:
    """Look up what a path calls ``name``; what has no robot of its own is passed over, as is `nominal`.

    Raises:
        ServiceError: it does not exist, or the caller may not see it.

    """
    if name in LOOKED_UP and value != NOMINAL:
        LOOKED_UP[name](session, value)
