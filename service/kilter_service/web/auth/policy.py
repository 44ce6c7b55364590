"""Which role each route needs: the one place that says it. A route that is not named here needs an admin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from kilter_service.contract.server import Role

Kind = Literal[
    "corrections", "stops", "drops", "files", "checks", "documents", "reads"
]  # of work: each has its own room


class Rule(NamedTuple):
    """What a route needs. ``role`` None: nothing, not even a token.

    ``computes``: it is more than reading what is stored, so its rate is limited. ``server``: it concerns the whole server,
    so a token that is limited to some robots may not use it. ``instead`` is what to do when the answer takes longer to
    compute than the server allows; only of routes that store nothing, because what is stored is acknowledged. ``room`` None:
    the one for what the request carries.
    """

    role: Role | None
    computes: bool = False
    server: bool = False
    instead: str = ""
    room: Kind | None = None

    def with_time_limit(self, instead: str) -> Rule:
        """Return the same with a limited time."""
        return self._replace(instead=instead)

    def within(self, room: Kind) -> Rule:
        """Return the same in a room of its own."""
        return self._replace(room=room)


OPEN = Rule(None)
READ = Rule("viewer")
WATCH = Rule("viewer", server=True)
READ_COMPUTED = Rule("viewer", computes=True)
OPERATE = Rule("operator", computes=True)
STOP = OPERATE.within("stops")
DROP = OPERATE.within("drops")
ADMINISTER = Rule("admin", computes=True)
SERVER = Rule("admin", computes=True, server=True)

SMALLER = "Send a smaller document, or try again when the server is less busy."
LATER = "Try again when the server is less busy."

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
    "POST /v1/login-links": READ_COMPUTED,
    "GET /v1/robots": READ,
    "GET /v1/robots/{robot}": READ,
    "GET /v1/robots/{robot}/today": READ,
    "GET /v1/robots/{robot}/bridges": READ,
    "PUT /v1/robots/{robot}/bridges/{bridge}": Rule("operator"),  # every 2 s of each bridge, so it has no rate
    "GET /v1/robots/{robot}/drift": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/drift": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/robots/{robot}/acceptance": READ_COMPUTED.with_time_limit("Name fewer campaigns."),
    "GET /v1/robots/{robot}/campaigns": READ,
    "GET /v1/instruments": READ,
    "POST /v1/instruments": SERVER,
    "GET /v1/robots/{robot}/versions": READ,
    "GET /v1/robots/{robot}/activations": READ,
    "GET /v1/robots/{robot}/meshes": READ,
    "GET /v1/robots/{robot}/urdf-shapes": READ,
    "GET /v1/robots/{robot}/meshes/{link}": READ,
    "GET /v1/campaigns/{campaign}": READ,
    "GET /v1/campaigns/{campaign}/suspicious": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/campaigns/{campaign}/observations": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/jobs": READ,
    "GET /v1/jobs/{job}": READ,
    "GET /v1/jobs/{job}/events": READ,
    "GET /v1/fleet-jobs": READ,
    "GET /v1/fleet-jobs/{fleet_job}": READ,
    "GET /v1/versions/{version}": READ,
    "GET /v1/resolve": READ,
    "GET /v1/tombstones": READ,
    "GET /v1/versions/{version}/preview": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/versions/{a}/diff/{b}": READ_COMPUTED.with_time_limit(LATER),
    "GET /v1/versions/{version}/residuals": READ_COMPUTED.with_time_limit(
        "Name fewer campaigns, or submit an evaluate job (POST /v1/jobs)."
    ),
    "GET /v1/versions/{version}/export": READ_COMPUTED.with_time_limit(LATER),
    "POST /v1/robots/check": OPERATE.with_time_limit(SMALLER),
    "POST /v1/robots/convert": OPERATE.with_time_limit(SMALLER),
    "POST /v1/robots/from-circles": OPERATE.with_time_limit("Send fewer rows of each circle."),
    "POST /v1/frames": OPERATE.with_time_limit(SMALLER),
    "POST /v1/robots/{robot}/forward": OPERATE.with_time_limit("Send fewer rows."),
    "POST /v1/robots/{robot}/inverse": OPERATE.with_time_limit("Send fewer poses."),
    "POST /v1/robots/{robot}/correct": OPERATE.with_time_limit("Send the path in parts with fewer rows.").within(
        "corrections"
    ),
    "POST /v1/robots/{robot}/torques": OPERATE.with_time_limit("Send the path in parts with fewer rows.").within(
        "corrections"
    ),
    "POST /v1/robots/{robot}/observations/check": OPERATE.with_time_limit("Send fewer rows."),
    "POST /v1/robots/{robot}/campaigns": OPERATE,
    "PATCH /v1/campaigns/{campaign}": OPERATE,
    "POST /v1/campaigns/{campaign}/commit": OPERATE,
    "POST /v1/campaigns/{campaign}/observations": OPERATE,
    "POST /v1/campaigns/{campaign}/retire": OPERATE,
    "POST /v1/campaigns/{campaign}/restore": OPERATE,
    "DELETE /v1/campaigns/{campaign}": OPERATE,  # a staged one, which was never whole
    "POST /v1/jobs": OPERATE,
    "POST /v1/jobs/check": OPERATE.with_time_limit(
        "Name fewer campaigns, or submit it as a job (POST /v1/jobs), which has no such limit."
    ),
    "POST /v1/jobs/{job}/cancel": OPERATE,
    "POST /v1/fleet-jobs": OPERATE,
    "POST /v1/fleet-jobs/{fleet_job}/cancel": OPERATE,
    "PATCH /v1/versions/{version}": OPERATE,
    "POST /v1/versions/{version}/retire": OPERATE,
    "POST /v1/versions/{version}/restore": OPERATE,
    "POST /v1/versions/{version}/activate": STOP,
    "POST /v1/robots/{robot}/rollback": STOP,
    "POST /v1/robots/{robot}/repairs": OPERATE,
    "DELETE /v1/robots/{robot}/repairs/{repair}": OPERATE,
    "POST /v1/robots/{robot}/stream/sessions": OPERATE,
    "POST /v1/robots": ADMINISTER,
    "PATCH /v1/robots/{robot}": ADMINISTER,
    "DELETE /v1/robots/{robot}": ADMINISTER,
    "POST /v1/robots/{robot}/retire": ADMINISTER,
    "POST /v1/robots/{robot}/restore": ADMINISTER,
    "POST /v1/robots/{robot}/purge": ADMINISTER,
    "POST /v1/campaigns/{campaign}/purge": ADMINISTER,
    "POST /v1/versions/{version}/purge": ADMINISTER,
    "PUT /v1/robots/{robot}/meshes/{link}": ADMINISTER,
    "DELETE /v1/robots/{robot}/meshes/{link}": ADMINISTER,
    "GET /v1/tokens": SERVER,
    "POST /v1/tokens": SERVER,
    "DELETE /v1/tokens/{token}": SERVER,
    "GET /v1/audit": SERVER,
}

# The page: each view needs what the routes of /v1 need that say or do the same.
PAGE_RULES: Mapping[str, Rule] = {
    "GET /assets/{name}": OPEN,
    "GET /login": OPEN,
    "POST /login": OPEN,
    "POST /login/link": OPEN,
    "POST /logout": OPEN,
    "GET /": READ,
    "GET /find": READ,
    "GET /robots/{robot}": READ,
    "GET /new-robot": READ,
    "POST /new-robot/check": OPERATE.with_time_limit(SMALLER),
    "POST /new-robot": ADMINISTER,
    "GET /robots/{robot}/correct": READ,
    "GET /robots/{robot}/kit": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/settings": READ,
    "POST /robots/{robot}/remarks": ADMINISTER,
    "POST /robots/{robot}/repairs": OPERATE,
    "POST /robots/{robot}/steps": OPERATE,
    "POST /robots/{robot}/goals": ADMINISTER,
    "POST /robots/{robot}/repairs/{repair}/remove": OPERATE,
    "POST /robots/{robot}/compensation": ADMINISTER,
    "GET /robots/{robot}/state": READ,
    "GET /robots/{robot}/worst": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/pose": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/arm.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/places.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/reach.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/meshes/{link}": READ_COMPUTED.with_time_limit(LATER),
    "POST /robots/{robot}/meshes/{link}": ADMINISTER,
    "POST /robots/{robot}/meshes/{link}/remove": ADMINISTER,
    "GET /robots/{robot}/versions": READ,
    "GET /robots/{robot}/versions/compare": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}": READ,
    "GET /versions/{version}/exports": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}/contributions": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}/by-factor": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}/workspace": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}/activation": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{a}/compare/{b}": READ_COMPUTED.with_time_limit(LATER),
    "GET /robots/{robot}/rollback": READ_COMPUTED.with_time_limit(LATER),
    "POST /versions/{version}/activate": STOP,
    "POST /robots/{robot}/rollback": STOP,
    "GET /robots/{robot}/campaigns": READ,
    "GET /robots/{robot}/campaigns/new": READ,
    "GET /robots/{robot}/campaigns/new/board.zip": READ,
    "GET /robots/{robot}/campaigns/new/reading": READ,
    "GET /robots/{robot}/campaigns/new/{draft}": READ,
    "POST /robots/{robot}/campaigns/new/file": DROP,
    "POST /robots/{robot}/campaigns/new/{draft}/columns": DROP,
    "POST /robots/{robot}/campaigns/new/{draft}/map": DROP,
    "POST /robots/{robot}/campaigns/new/{draft}/rig": DROP,
    "POST /robots/{robot}/campaigns/new/{draft}/read": DROP,
    "POST /robots/{robot}/campaigns/new/{draft}/store": OPERATE.within("files"),
    "POST /robots/{robot}/campaigns/new/{draft}/discard": OPERATE,
    "GET /campaigns/{campaign}": READ_COMPUTED.with_time_limit(LATER),
    "GET /campaigns/{campaign}/series.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /campaigns/{campaign}/values.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /campaigns/{campaign}/rows.json": READ_COMPUTED.with_time_limit(LATER),
    "GET /campaigns/{campaign}/rows": READ_COMPUTED.with_time_limit(LATER),
    "GET /campaigns/{campaign}/rows.csv": READ_COMPUTED.with_time_limit(LATER),
    "POST /campaigns/{campaign}/rows/aside": OPERATE,
    "POST /campaigns/{campaign}/change": OPERATE,
    "POST /campaigns/{campaign}/retire": OPERATE,
    "POST /campaigns/{campaign}/restore": OPERATE,
    "GET /robots/{robot}/stream": READ,
    "GET /robots/{robot}/stream/events": READ,
    "GET /robots/{robot}/bridges": READ,
    "GET /versions/{version}/report": READ_COMPUTED.with_time_limit(LATER),
    "GET /versions/{version}/report.pdf": READ_COMPUTED.with_time_limit(LATER),
    "GET /jobs/{job}/report": READ_COMPUTED.with_time_limit(LATER),
    "GET /jobs/{job}/report.pdf": READ_COMPUTED.with_time_limit(LATER),
    "GET /jobs/{job}/report.html": READ_COMPUTED.with_time_limit(LATER),
    "GET /jobs": READ,
    "GET /jobs/compare": READ,
    "GET /audit": SERVER,
    "GET /access": SERVER,
    "POST /access": SERVER,
    "POST /access/{token}/revoke": SERVER,
    "POST /jobs/{job}/gap/plan": OPERATE,
    "POST /jobs/{job}/gap/again": OPERATE,
    "GET /robots/{robot}/jobs": READ,
    "GET /robots/{robot}/jobs/campaigns": READ,
    "POST /robots/{robot}/jobs/check": OPERATE.with_time_limit(LATER),
    "POST /robots/{robot}/jobs": OPERATE,
    "GET /jobs/{job}": READ,
    "GET /jobs/{job}/poses.csv": READ,
    "POST /jobs/{job}/cancel": OPERATE,
}


def rule_for_route(route: str) -> Rule:
    """Return what a route (``"GET /v1/robots"``) needs."""
    read = "GET" + route.removeprefix("HEAD") if route.startswith("HEAD ") else route
    return RULES.get(read) or PAGE_RULES.get(read, SERVER)
