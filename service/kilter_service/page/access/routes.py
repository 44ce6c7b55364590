"""Who may do what, for those who administer the server: seen, given and ended as by ``kilter server token``."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import HTMLResponse

from kilter_service.contract.tokens import ROLE, NewToken, Role, TokenName
from kilter_service.ground.paging import Page
from kilter_service.page.route import PageRoute
from kilter_service.page.shared.lists import Asked, select_page
from kilter_service.page.shell import get_root_path, redirect, render
from kilter_service.robots import service as robots
from kilter_service.web.auth.access import Admin
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp
from kilter_service.web.tokens import service

router = APIRouter(include_in_schema=False, route_class=PageRoute)
ROLES: tuple[Role, ...] = ("viewer", "operator", "admin")


@router.get("/access")
def show_tokens(request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show who may do what, newest first."""
    found = select_page(
        service.list_tokens(database, Page()).tokens,
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
    return render(request, "access/made.html", 201, made=service.add(database, wanted, actor))


@router.post("/access/{token}/revoke")
def revoke(token: str, request: Request, database: DatabaseOfApp, settings: SettingsOfApp, actor: Admin) -> Response:
    """End a token at once, and the sessions of streams that it asked for."""
    ended = service.revoke(database, token, actor)
    request.app.state.end_sessions(database, settings, ended.id)
    return redirect(request, f"{get_root_path(request)}/access")
