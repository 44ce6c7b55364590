"""The gate of every route: who sends the request, and whether that is enough, before its body is read.

Where a request comes from: straight from this machine, or passed on.
"""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from kilter_service.ground.caller import ADMIN, ANYBODY, CALLER, RANK, Caller
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.web import logins
from kilter_service.web.auth.policy import Rule, rule_for_route

# A token that is limited to robots: what a path names must be of one of them, before the body is read.
#
# Stores leave out what the caller may not see (`kilter_service.ground.caller`), so everything else is as unknown to
# such a token as what does not exist: 404. The application says how what a path names is looked up: nothing here
# knows the features.

LookUp = Callable[[Session, str, str], None]


def check_path(database: Database, look_up: LookUp, named: Mapping[str, object]) -> None:
    """Look up what a path names, each by its name in paths and its value.

    Raises:
        ServiceError: it does not exist, or the caller may not see it.

    """
    with database.reading() as session:
        for name, value in named.items():
            look_up(session, name, str(value))


PLAIN_READS = frozenset({"GET", "HEAD"})


class Credentials(NamedTuple):
    """What a request was let in with: the hash of its token (None: without one), and the login that stands for it, if any."""

    token_sha256: str | None
    login: str


async def admit(request: Request, path: str) -> Rule:
    """Let a request in, or refuse it; whoever sends it is its caller from then on.

    Raises:
        ServiceError: no token or one that does not hold, a role that is too low, another robot, or too often.

    """
    route = f"{request.method} {path}"
    rule = rule_for_route(route)
    caller = await _caller(request, rule, route)
    request.state.caller = caller
    CALLER.set(caller)
    if rule.role is None:
        return rule
    _check_role(caller, rule, route)
    if rule.computes:
        request.app.state.rates.count_request(caller.sender)
    if caller.robots is not None:
        if rule.server:
            raise ServiceError(
                f"Token {caller.actor!r} is limited to robots {', '.join(sorted(caller.robots))}, and {route} concerns the "
                "whole server: use a token that is not limited.",
                code="token_limited",
                robots=sorted(caller.robots),
            )
        state = request.app.state
        await run_in_threadpool(check_path, state.database, state.look_up, request.path_params)
    return rule


async def _caller(request: Request, rule: Rule, route: str) -> Caller:
    settings: Settings = request.app.state.settings
    address, ids = client_address(request, settings), {name: str(value) for name, value in request.path_params.items()}
    nobody = Caller(ANYBODY, "viewer", None, "", address, route, ids)
    if rule.role is None:
        return nobody
    scheme, _, given = request.headers.get("authorization", "").partition(" ")
    secret = given.strip()
    bearer = scheme.lower() == "bearer" and bool(secret)
    sha256 = logins.hash_secret(secret) if bearer else await _login_token_hash(request)
    request.state.credentials = Credentials(sha256, "" if bearer else request.cookies.get(logins.COOKIE, ""))
    if sha256 is None:
        if rule.role == "viewer" and request.method in PLAIN_READS and is_direct(request, settings):
            return nobody
        raise ServiceError(
            f"This needs a token of role {rule.role}: send `Authorization: Bearer ...` with your token, or with the content "
            "of the `token` file in the server's data folder (the client does so when KILTER_TOKEN is set or it runs on the "
            "same machine). Plain reads on the server's own machine need none, unless a proxy passes them on.",
            code="token_missing",
            role=rule.role,
        )
    if secrets.compare_digest(sha256, logins.hash_secret(request.app.state.token)):
        return Caller(ADMIN, "admin", None, "", address, route, ids)
    found = await run_in_threadpool(logins.get_valid_token, request.app.state.database, sha256)
    robots = None if found.robots is None else frozenset(found.robots)
    return Caller(found.name, found.role, robots, found.id, address, route, ids)


async def _login_token_hash(request: Request) -> str | None:
    """Return the hash of the token that whoever uses this browser logged in with; None: nobody did."""
    kept = request.cookies.get(logins.COOKIE, "")
    found = await run_in_threadpool(logins.login_token_hash, request.app.state.database, kept) if kept else None
    if found is not None and request.method not in PLAIN_READS:
        logins.check_csrf(kept, request.headers.get(logins.CSRF_HEADER, ""))
    return found


def _check_role(caller: Caller, rule: Rule, route: str) -> None:
    if rule.role is not None and RANK[caller.role] < RANK[rule.role]:
        raise ServiceError(
            f"Token {caller.actor!r} has the role {caller.role}, and {route} needs {rule.role}: ask an admin for such a "
            f"token (`kilter server token add NAME --role {rule.role}`).",
            code="role_too_low",
            role=caller.role,
            needed=rule.role,
        )


def get_caller(request: Request) -> Caller:
    """Return who sends a request."""
    caller: Caller = request.state.caller
    return caller


async def actor(request: Request) -> str:
    """Return what the records call whoever sends a request."""
    return get_caller(request).actor


Admin = Annotated[str, Depends(actor)]  # what the records call whoever makes a change; `policy` says who may


FORWARDING = ("forwarded", "via", "x-real-ip")
OTHER_SITES = frozenset({"cross-site", "same-site"})


def is_direct(request: HTTPConnection, settings: Settings) -> bool:
    """Whether a request was sent by a program on this machine, to this machine by name, and nobody passed it on.

    A name that an attacker's DNS points here is not a name of this machine. A page of another site that a browser shows
    here is not a program of this machine's user.
    """
    if settings.proxy or not settings.is_loopback or request.client is None:
        return False
    if any(name in FORWARDING or name.startswith("x-forwarded-") for name in request.headers):
        return False
    if request.headers.get("sec-fetch-site", "none") in OTHER_SITES:
        return False
    return is_loopback_name(request.client.host) and is_loopback_name(
        parse_host_header(request.headers.get("host", ""))
    )


def parse_host_header(header: str) -> str:
    """Return the host of a Host header, in lower case and without its port and brackets."""
    text = header.strip().lower()
    if text.startswith("["):
        return text[1:].partition("]")[0]
    return text.partition(":")[0].rstrip(".")


def address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return a text as an address; None when it is a name."""
    try:
        found = ipaddress.ip_address(text)
    except ValueError:
        return None
    return getattr(found, "ipv4_mapped", None) or found


def is_loopback_name(host: str) -> bool:
    """Whether a host is this machine, seen from this machine."""
    found = address(host)
    return host == "localhost" if found is None else found.is_loopback


def client_address(request: HTTPConnection, settings: Settings) -> str:
    """Return the address a request comes from; what a proxy says counts only where the proxy is one of the settings."""
    peer = "" if request.client is None else request.client.host
    if not settings.trusts(peer):
        return peer
    passed = [part.strip() for line in request.headers.getlist("x-forwarded-for") for part in line.split(",")]
    # The last one was written by the nearest proxy; what stands before it may be invented.
    unknown = [part for part in passed if part and not settings.trusts(part)]
    return unknown[-1][:64] if unknown else peer
