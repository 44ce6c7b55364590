"""Tokens over HTTP, and who one is."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from kilter_service.contract.tokens import Identity, LoginLink, MadeToken, NewLoginLink, NewToken, Token, TokenList
from kilter_service.web.auth.access import Admin, get_caller
from kilter_service.web.logins import service as logins
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, PageOfList, SettingsOfApp
from kilter_service.web.tokens import service

router = APIRouter(prefix="/v1", tags=["access"], route_class=GuardedRoute)


@router.get("/whoami")
def whoami(request: Request) -> Identity:
    """Say who sends this request, in which role, and for which robots."""
    caller = get_caller(request)
    robots = None if caller.robots is None else sorted(caller.robots)
    return Identity(actor=caller.actor, token_id=caller.token_id, role=caller.role, robots=robots)


@router.post("/tokens", status_code=201)
def add(wanted: NewToken, response: Response, database: DatabaseOfApp, actor: Admin) -> MadeToken:
    """Make a token; what to send with requests is shown this once only."""
    response.headers["Cache-Control"] = "no-store"
    return service.add(database, wanted, actor)


@router.post("/login-links", status_code=201)
def link(wanted: NewLoginLink, request: Request, response: Response, database: DatabaseOfApp) -> LoginLink:
    """Make a link that logs a browser in once, in the role of whoever asks; its secret is in this answer and nowhere else."""
    response.headers["Cache-Control"] = "no-store"
    secret, until = logins.link(database, request.state.credentials.token_sha256, wanted.minutes)
    return LoginLink(path=f"/login#{secret}", expires_at=until)


@router.get("/tokens")
def listed(database: DatabaseOfApp, page: PageOfList) -> TokenList:
    """List the tokens, newest first; also those that expired or were revoked."""
    return service.list_tokens(database, page)


@router.delete("/tokens/{token}")
def revoke(token: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin) -> Token:
    """End a token at once, and the sessions of streams that it asked for; a repeat changes nothing."""
    ended = service.revoke(database, token, actor)
    request.app.state.end_sessions(database, settings, ended.id)  # handed in: the stream is above
    return ended
