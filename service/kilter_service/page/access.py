"""Logging in with a token, and out; and who may do what, seen, given and ended as by ``kilter server token``."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Form, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.contract.server import ROLE, NewToken, Role, TokenName
from kilter_service.ground.caller import ADMIN, CALLER, Caller
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.page.answers import get_root_path, redirect, render, router
from kilter_service.page.shared.lists import Asked, select_page
from kilter_service.robots import service as robots
from kilter_service.web import audit, logins
from kilter_service.web.auth.access import Admin, get_caller
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp

LONGEST = 500


@router.get("/login")
def form(request: Request, then: str = "/") -> HTMLResponse:
    """Ask for a token."""
    return render(request, "login.html", then=_local_path(then), problem="")


@router.post("/login")
def log_in_by_token(
    request: Request,
    database: DatabaseOfApp,
    token: Annotated[str, Form(max_length=LONGEST)],
    then: Annotated[str, Form(max_length=2000)] = "/",
) -> Response:
    """Give the browser a login, if the token holds."""
    return _start_login_session(request, database, lambda: logins.hash_secret(token.strip()), then)


@router.post("/login/link")
def log_in_by_link(
    request: Request,
    database: DatabaseOfApp,
    link: Annotated[str, Form(max_length=LONGEST)],
    then: Annotated[str, Form(max_length=2000)] = "/",
) -> Response:
    """Give the browser a login, if the link was not used yet."""
    return _start_login_session(request, database, lambda: logins.take_link(database, link.strip()), then)


def _start_login_session(request: Request, database: Database, token_sha256: Callable[[], str], then: str) -> Response:
    request.app.state.rates.count_request(get_caller(request).address)
    try:
        sha256 = token_sha256()
        CALLER.set(_caller(request, database, sha256))
    except ServiceError as error:
        audit.note(request, error.code)
        return render(request, "login.html", 401, then=_local_path(then), problem=error.message)
    answer = redirect(request, _local_path(then))
    answer.set_cookie(
        logins.COOKIE,
        logins.create_login(database, sha256),
        max_age=logins.HOURS * 3600,
        httponly=True,
        samesite="strict",
        secure=_is_secure(request),
        path=get_root_path(request) or "/",
    )
    return answer


def _caller(request: Request, database: Database, sha256: str) -> Caller:
    """Return who logs in, for the audit."""
    asked = get_caller(request)
    if secrets.compare_digest(sha256, logins.hash_secret(request.app.state.token)):
        return replace(asked, actor=ADMIN, role="admin")
    found = logins.get_valid_token(database, sha256)
    return replace(asked, actor=found.name, role=found.role, token_id=found.id)


def _is_secure(request: Request) -> bool:
    """Whether the browser speaks HTTPS, to this server or to its proxy."""
    settings: Settings = request.app.state.settings
    peer = "" if request.client is None else request.client.host
    forwarded = request.headers.get("x-forwarded-proto", "") if settings.trusts(peer) else ""
    return request.url.scheme == "https" or forwarded.lower() == "https"


@router.post("/logout")
def log_out(request: Request, database: DatabaseOfApp) -> Response:
    """End the login."""
    logins.log_out(database, request.cookies.get(logins.COOKIE, ""))
    answer = redirect(request, "/login")
    answer.delete_cookie(logins.COOKIE, path=get_root_path(request) or "/")
    return answer


def _local_path(then: str) -> str:
    """Return a path of this server: nobody is sent elsewhere by a link to the login."""
    parts = urlsplit(then)
    outside = parts.scheme or parts.netloc or not then.startswith("/") or then.startswith(("//", "/\\"))
    return "/" if outside else then


ROLES: tuple[Role, ...] = ("viewer", "operator", "admin")


@router.get("/access")
def show_tokens(request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show who may do what, newest first."""
    found = select_page(
        logins.list_tokens(database, Page()).tokens,
        Asked.from_request(request, ("role",)),
        lambda one: f"{one.name} {one.role} {' '.join(one.robots or [])} {one.created_by} {one.id}",
        {"name": lambda one: one.name, "role": lambda one: ROLES.index(one.role), "made": lambda one: one.created_at},
        {"role": lambda one: one.role},
        "-made",
    )
    named = [one.name for one in robots.list_robots(database, Page()).robots]
    return render(request, "access/list.html", part=found, roles=ROLES, meaning=ROLE, robots=named)


@router.post("/access")
def add(
    request: Request,
    database: DatabaseOfApp,
    actor: Admin,
    name: Annotated[TokenName, Form()],
    role: Annotated[Role, Form()],
    robot: Annotated[list[str] | None, Form()] = None,
    days: Annotated[int, Form(ge=0, le=3650)] = 365,
) -> HTMLResponse:
    """Make a token; its secret is in this answer and nowhere else."""
    wanted = NewToken(name=name, role=role, robots=robot or None, days=days or None)
    return render(request, "access/made.html", 201, made=logins.add(database, wanted, actor))


@router.post("/access/{token}/revoke")
def revoke(token: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin) -> Response:
    """End a token at once, and the sessions of streams that it asked for."""
    ended = logins.revoke(database, token, actor)
    request.app.state.end_sessions(database, settings, ended.id)
    return redirect(request, "/access")
