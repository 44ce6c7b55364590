"""Who sends a request: its role, the robots it may see, and where it comes from.

The route sets it before anything of the request is read; stores leave out what the caller may not see, and the audit says
who made a change. A process without requests (a worker, the corrector) has no caller and sees everything.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, cast

from kilter_service.contract.server import Role

ADMIN = "admin"
ANYBODY = "anybody"
UNKNOWN = "unknown"
RANK: Mapping[str, int] = {"viewer": 0, "operator": 1, "admin": 2}


@dataclass(frozen=True)
class Caller:
    """Who sends a request; ``robots`` None: of all robots. ``token_id`` is empty for the admin token and for nobody's."""

    actor: str
    role: Role
    robots: frozenset[str] | None = None
    token_id: str = ""
    address: str = ""
    route: str = ""
    ids: Mapping[str, str] = field(default_factory=dict)

    @property
    def sender(self) -> str:
        """Who is counted as one person: a token, whatever logins it has, or an address where there is none."""
        return self.address if self.actor == ANYBODY else self.token_id or self.actor


CALLER: ContextVar[Caller | None] = ContextVar("kilter_caller", default=None)


def as_document() -> dict[str, Any]:
    """Return what is kept of the caller with something that is done later in another process; empty: nobody asked."""
    caller = CALLER.get()
    if caller is None:
        return {}
    kept = {"actor": caller.actor, "role": caller.role, "token_id": caller.token_id, "address": caller.address}
    return kept if caller.robots is None else {**kept, "robots": sorted(caller.robots)}


@contextmanager
def on_behalf(asked_by: Mapping[str, str], route: str, ids: Mapping[str, str]) -> Iterator[None]:
    """Let the audit say who asked for what this process changes now. Jobs of earlier releases do not know."""
    known = asked_by or {"actor": UNKNOWN, "role": "viewer"}
    caller = Caller(
        known["actor"],
        cast(Role, known["role"]),
        None,
        known.get("token_id", ""),
        known.get("address", ""),
        route,
        ids,
    )
    before = CALLER.set(caller)
    try:
        yield
    finally:
        CALLER.reset(before)


def allowed_robots() -> frozenset[str] | None:
    """Return the names of the robots that the caller may see; None: all."""
    caller = CALLER.get()
    return None if caller is None else caller.robots


def may_see(robot: str) -> bool:
    """Whether the caller may see a robot and what belongs to it."""
    robots = allowed_robots()
    return robots is None or robot in robots
