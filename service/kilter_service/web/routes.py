"""The audit, tokens and health over HTTP; health is open to everybody, for what watches a server has no token."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request, Response

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
from kilter_service.ground.settings import code_version
from kilter_service.web import audit, logins
from kilter_service.web import health as health_service
from kilter_service.web.auth.access import Admin, get_caller
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
