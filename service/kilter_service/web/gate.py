"""What a request must be before it is looked at: for a name of this server, from its proxy, and from no page of another site.

A page in a browser can send requests to any name, also to one that its own DNS points to this machine. It cannot choose the
Host header, the Origin header or what the browser says of the site it is from.
"""

from __future__ import annotations

import socket

from fastapi import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings, parse_name_list
from kilter_service.web.auth.access import PLAIN_READS
from kilter_service.web.auth.forwarded import OTHER_SITES, address, is_loopback_name, parse_host_header
from kilter_service.web.problems import problem


class Gate:
    """Refuse requests that are not for this server, or not from where they may come."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._settings = app, settings
        self._names = {"localhost", settings.host.lower(), *parse_name_list(settings.hosts)}
        if not settings.is_loopback:
            self._names.add(socket.gethostname().lower())  # what `server.json` says

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "http":
            request = Request(scope)
            try:
                self._check(request)
            except ServiceError as error:
                await problem(request, error.code, error.message, error.context)(scope, receive, send)
                return
        await self.app(scope, receive, send)

    def _check(self, request: Request) -> None:
        self._check_peer("" if request.client is None else request.client.host)
        header = request.headers.get("host", "")
        self._check_host(parse_host_header(header))
        if request.method not in PLAIN_READS:
            _check_origin(request, header)

    def _check_peer(self, peer: str) -> None:
        if self._settings.proxy and not self._settings.trusts(peer) and not is_loopback_name(peer):
            raise ServiceError(
                f"This server is reached through its proxy only, and {peer or 'this peer'} is not it: send the request to "
                "the proxy, or add the address to KILTER_PROXY on the server.",
                code="proxy_only",
                peer=peer,
            )

    def _check_host(self, host: str) -> None:
        # An address was not looked up, so nobody's DNS can have pointed it here.
        if host not in self._names and address(host) is None:
            raise ServiceError(
                f"This server is not called {host[:100]!r}: use localhost, its address or one of its names, or add this one "
                "to KILTER_HOSTS on the server.",
                code="host_refused",
                host=host[:100],
            )


def _check_origin(request: Request, host: str) -> None:
    origin = request.headers.get("origin")
    site = request.headers.get("sec-fetch-site", "none")
    if site in OTHER_SITES or (origin is not None and origin.lower().partition("://")[2] != host.lower()):
        raise ServiceError(
            f"A page of another site ({(origin or site)[:100]}) may change nothing here: use the server's own /docs, "
            "`kilter` or the library. A proxy must pass on the Host header as it is.",
            code="origin_refused",
        )
