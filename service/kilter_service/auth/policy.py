"""Which role each route needs: the one place that says it. A route that is not named here needs an admin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from kilter_service.contract.tokens import Role


class Rule(NamedTuple):
    """What a route needs. ``role`` None: nothing, not even a token.

    ``computes``: it is more than reading what is stored, so its rate and its time are limited. ``server``: it concerns the
    whole server, so a token that is limited to some robots may not use it.
    """

    role: Role | None
    computes: bool = False
    server: bool = False


OPEN = Rule(None)
READ = Rule("viewer")
WATCH = Rule("viewer", server=True)
READ_COMPUTED = Rule("viewer", computes=True)
OPERATE = Rule("operator", computes=True)
ADMINISTER = Rule("admin", computes=True)
SERVER = Rule("admin", computes=True, server=True)

RULES: Mapping[str, Rule] = {
    # What watches a server has no token, and the pages of /docs say nothing about this one.
    "GET /v1/health": OPEN,
    "GET /v1/health/live": OPEN,
    "GET /v1/health/ready": OPEN,
    "GET /docs": OPEN,
    "GET /docs/start.js": OPEN,
    "GET /docs/{name}": OPEN,
    "GET /metrics": WATCH,
    "GET /v1/whoami": READ,
    "GET /v1/robots": READ,
    "GET /v1/robots/{robot}": READ,
    "GET /v1/robots/{robot}/campaigns": READ,
    "GET /v1/robots/{robot}/versions": READ,
    "GET /v1/robots/{robot}/activations": READ,
    "GET /v1/campaigns/{campaign}": READ,
    "GET /v1/jobs": READ,
    "GET /v1/jobs/{job}": READ,
    "GET /v1/jobs/{job}/events": READ,
    "GET /v1/versions/{version}": READ,
    "GET /v1/resolve": READ,
    "GET /v1/tombstones": READ,
    "GET /v1/versions/{version}/preview": READ_COMPUTED,
    "GET /v1/versions/{a}/diff/{b}": READ_COMPUTED,
    "GET /v1/versions/{version}/residuals": READ_COMPUTED,
    "GET /v1/versions/{version}/export": READ_COMPUTED,
    "POST /v1/robots/check": OPERATE,
    "POST /v1/robots/convert": OPERATE,
    "POST /v1/robots/from-circles": OPERATE,
    "POST /v1/frames": OPERATE,
    "POST /v1/robots/{robot}/correct": OPERATE,
    "POST /v1/robots/{robot}/campaigns": OPERATE,
    "PATCH /v1/campaigns/{campaign}": OPERATE,
    "POST /v1/campaigns/{campaign}/commit": OPERATE,
    "POST /v1/campaigns/{campaign}/observations": OPERATE,
    "POST /v1/campaigns/{campaign}/retire": OPERATE,
    "POST /v1/campaigns/{campaign}/restore": OPERATE,
    "DELETE /v1/campaigns/{campaign}": OPERATE,  # a staged one, which was never whole
    "POST /v1/jobs": OPERATE,
    "POST /v1/jobs/check": OPERATE,
    "POST /v1/jobs/{job}/cancel": OPERATE,
    "PATCH /v1/versions/{version}": OPERATE,
    "POST /v1/versions/{version}/retire": OPERATE,
    "POST /v1/versions/{version}/restore": OPERATE,
    "POST /v1/versions/{version}/activate": OPERATE,
    "POST /v1/robots/{robot}/rollback": OPERATE,
    "POST /v1/robots/{robot}/stream/sessions": OPERATE,
    "POST /v1/robots": ADMINISTER,
    "PATCH /v1/robots/{robot}": ADMINISTER,
    "DELETE /v1/robots/{robot}": ADMINISTER,
    "POST /v1/robots/{robot}/retire": ADMINISTER,
    "POST /v1/robots/{robot}/restore": ADMINISTER,
    "POST /v1/robots/{robot}/purge": ADMINISTER,
    "POST /v1/campaigns/{campaign}/purge": ADMINISTER,
    "POST /v1/versions/{version}/purge": ADMINISTER,
    "GET /v1/tokens": SERVER,
    "POST /v1/tokens": SERVER,
    "DELETE /v1/tokens/{token}": SERVER,
    "GET /v1/audit": SERVER,
}


def rule_of(route: str) -> Rule:
    """Return what a route (``"GET /v1/robots"``) needs."""
    return RULES.get("GET" + route.removeprefix("HEAD") if route.startswith("HEAD ") else route, SERVER)
