"""What every view of the page shares: the templates, what they may call, and the headers of the answers."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from jinja2 import Environment, PackageLoader, StrictUndefined

from kilter_service.contract.tokens import Role
from kilter_service.ground.caller import ANYBODY, CALLER, RANK
from kilter_service.ground.version import code_version
from kilter_service.page import assets, words
from kilter_service.web.logins import service as logins

# No inline script or style, no eval, nothing of another host; nobody may show the page within a page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "font-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
WHOLE = ("{% extends", "<!DOCTYPE")  # how the template of a whole page begins
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",  # measurements stay out of the browser's cache
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
}


def render(request: Request, template: str, status: int = 200, **shown: Any) -> HTMLResponse:
    """Fill a template, which extends ``base.html`` or is a part of a page; a part that is opened alone becomes a page."""
    alone = _is_part_of_a_page(template) and not is_part(request)
    filled = environment().get_template("alone.html" if alone else template)
    text = filled.render(**shared_context(request), **shown, **({"part": template} if alone else {}))
    return HTMLResponse(text, status, HEADERS)


@cache
def _is_part_of_a_page(template: str) -> bool:
    loader = environment().loader
    return loader is not None and not loader.get_source(environment(), template)[0].lstrip().startswith(WHOLE)


def shared_context(request: Request) -> dict[str, Any]:
    """Return what every template may use."""
    kept = request.cookies.get(logins.COOKIE, "")
    caller = CALLER.get()
    return {
        "root": get_root_path(request),
        "path": request.url.path,
        "asset": lambda name: f"{get_root_path(request)}/assets/{assets.hashed_file_name(name)}",
        "actor": "" if caller is None or caller.actor == ANYBODY else caller.actor,
        "role": "" if caller is None else caller.role,
        "may": may,
        "csrf": logins.csrf_token(kept) if kept else "",
        "version_of_kilter": code_version(),
    }


def may(role: Role) -> bool:
    """Whether whoever looks at the page has this role; a template disables what they may not."""
    caller = CALLER.get()
    return caller is not None and RANK[caller.role] >= RANK[role]


@cache
def environment() -> Environment:
    """Return the templates. What they are not given is an error; everything they show is escaped."""
    loaded = Environment(
        loader=PackageLoader("kilter_service.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    loaded.filters.update(words.FILTERS)
    return loaded


def source(name: str) -> str:
    """Return a style sheet as it was written, for a document that is not read in a browser."""
    return (files("kilter_service.page") / "sources" / name).read_text(encoding="utf-8")


def get_root_path(request: Request) -> str:
    """Return the path under which a proxy shows this server, empty without one."""
    return str(request.scope.get("root_path", "")).rstrip("/")


def is_part(request: Request) -> bool:
    """Whether htmx asks for a part of a page."""
    return request.headers.get("hx-request") == "true"


def redirect(request: Request, address: str) -> Response:
    """Send the browser to another page, whether it asked for a page or for a part of one."""
    if is_part(request):
        return Response(status_code=204, headers={"HX-Redirect": address})
    return RedirectResponse(address, 303)
