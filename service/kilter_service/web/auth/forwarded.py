"""Where a request comes from: straight from this machine, or passed on."""

from __future__ import annotations

import ipaddress

from starlette.requests import HTTPConnection

from kilter_service.ground.settings import Settings

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
