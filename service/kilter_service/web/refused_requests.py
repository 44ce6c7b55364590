"""Refused requests in the audit: who was refused, from where, at which route, why and how often.

Anybody can be refused as often as they like. So refusals are counted in memory and written in groups, the first ones
after a moment and, while more keep coming, every ten minutes; what makes up ever new groups is one group in the end.
"""

from __future__ import annotations

import logging
import threading
from typing import NamedTuple

from fastapi import Request

from kilter_service.ground.caller import ANYBODY, CALLER, Caller
from kilter_service.ground.db import Database, audited
from kilter_service.ground.failure_log import Failing
from kilter_service.web.auth.forwarded import client_address

log = logging.getLogger("kilter.api")

NOTED = frozenset(
    {
        "token_missing",
        "token_wrong",
        "token_ended",
        "role_too_low",
        "token_limited",
        "origin_refused",
        "proxy_only",
        "host_refused",
        "csrf_missing",
    }
)
MOST_GROUPS = 10
FIRST_S, LONGEST_S = 5.0, 600.0
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class Group(NamedTuple):
    """What is counted together."""

    code: str
    caller: Caller


OTHERS = Group("several", Caller(ANYBODY, "viewer", route="(several)"))


class Refusals:
    """Refusals of one process, until they are written."""

    def __init__(self, database: Database, first_s: float = FIRST_S) -> None:
        self._database, self._first_s = database, first_s
        self._lock = threading.Lock()
        self._groups: dict[tuple[str, ...], tuple[Group, int]] = {}
        self._pause_s = first_s
        self._timer: threading.Timer | None = None
        self._closed = False
        self._writing = Failing(log, "refused requests cannot be written to the audit")

    def count(self, group: Group) -> None:
        """Count one; it is written later."""
        with self._lock:
            self._add(group, 1)
            if self._timer is None and not self._closed:
                self._wait()

    def _add(self, group: Group, times: int) -> None:
        key = _key(group)
        if key not in self._groups and len(self._groups) >= MOST_GROUPS:
            group, key = OTHERS, _key(OTHERS)
        self._groups[key] = (group, self._groups.get(key, (group, 0))[1] + times)

    def _wait(self) -> None:
        self._timer = threading.Timer(self._pause_s, self._due)
        self._timer.daemon = True
        self._timer.start()

    def _due(self) -> None:
        any_written = self.write()
        with self._lock:
            self._pause_s = min(2.0 * self._pause_s, LONGEST_S) if any_written else self._first_s
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            if any_written and not self._closed:  # whether it was quiet until then is seen at the next time
                self._wait()

    def write(self) -> bool:
        """Write what was counted, an entry for each group; returns whether there was anything."""
        with self._lock:
            found, self._groups = [*self._groups.values()], {}
        for at, (group, times) in enumerate(found):
            before = CALLER.set(group.caller)
            try:
                with self._database.transaction() as session:
                    audited.note(session, "refused", None, {"code": group.code, "times": times})
                self._writing.report_success()
            except Exception as error:  # whatever the database says: they wait for the next time
                self._writing.report_failure(error)
                with self._lock:
                    for kept in found[at:]:
                        self._add(*kept)
                break
            finally:
                CALLER.reset(before)
        return bool(found)

    def close(self) -> None:
        """Write what is left."""
        with self._lock:
            self._closed = True
            if self._timer is not None:
                self._timer.cancel()
        self.write()


def _key(group: Group) -> tuple[str, ...]:
    return (group.code, group.caller.actor, group.caller.token_id, group.caller.address, group.caller.route)


def note(request: Request, code: str) -> None:
    """Count a refused request for the audit, if a person who looks after the server would want to know."""
    app = request.scope.get("app")  # None where a part of the application runs alone
    refusals: Refusals | None = getattr(app.state, "refusals", None) if app is not None else None
    if code not in NOTED or refusals is None:
        return
    caller: Caller | None = getattr(request.state, "caller", None)
    if caller is None or caller.actor == ANYBODY:
        path = getattr(request.scope.get("route"), "path", "(none)")
        method = request.method if request.method in METHODS else "(none)"
        caller = Caller(
            ANYBODY, "viewer", None, "", client_address(request, request.app.state.settings), f"{method} {path}"
        )
    refusals.count(Group(code, caller))
