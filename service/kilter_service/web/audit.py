"""Reading the audit, whether it is whole, and the refused requests in it: who, from where, at which route, why, how often.

Anybody can be refused as often as they like. So refusals are counted in memory and written in groups, the first ones
after a moment and, while more keep coming, every ten minutes; what makes up ever new groups is one group in the end.
"""

from __future__ import annotations

import json
import logging
import re
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from fastapi import Request

from kilter_service.contract.server import AuditEntry, AuditPage
from kilter_service.ground.caller import ANYBODY, CALLER, Caller
from kilter_service.ground.db import Database, audited
from kilter_service.ground.db.audited import hash_entry
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.web import store
from kilter_service.web.auth.access import client_address
from kilter_service.web.store import AuditRecord

MOST = 1000
HASH_DIGITS = 64
TOLD = re.compile(r"the audit stands at (\d+):([0-9a-f]{64})")


class Head(NamedTuple):
    """The last entry of an audit that is whole; whoever noted it can tell later that none after it was cut off."""

    number: int
    sha256: str


def parse_head(text: str | None) -> Head | None:
    """Read an entry that somebody noted, as NUMBER:SHA256.

    Raises:
        ServiceError: it is not written so.

    """
    if text is None:
        return None
    number, _, sha256 = text.partition(":")
    if not (number.isascii() and number.isdecimal() and len(sha256) == HASH_DIGITS):
        raise ServiceError(f"--head is {text[:100]!r}: give NUMBER:SHA256 as it was shown.", code="option_invalid")
    return Head(int(number), sha256)


def parse_journal_heads(journal: Path) -> list[Head]:
    """Return the entries that a log names; its lines may have any form.

    Raises:
        ServiceError: it cannot be read.

    """
    try:
        text = journal.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        message = f"--journal {journal} cannot be read ({error.strerror}): give the server's log as a file."
        raise ServiceError(message, code="option_invalid") from error
    return [Head(int(number), sha256) for number, sha256 in TOLD.findall(text)]


def list_entries(database: Database, page: Page) -> AuditPage:
    """List entries, oldest first; at most 1000 at once."""
    page = page._replace(limit=min(page.limit or MOST, MOST))
    with database.reading() as session:
        found = store.entries_on_page(session, page)
    shown, cursor = page.cut(found, lambda entry: (str(entry.number),))
    return AuditPage(entries=[_entry(record) for record in shown], next=cursor)


def _entry(record: AuditRecord) -> AuditEntry:
    return AuditEntry(
        **json.loads(record.content), content=record.content, previous=record.previous, sha256=record.sha256
    )


def verify(database: Database, *noted: Head) -> Head:
    """Compute all hashes anew and return the last entry.

    Raises:
        ServiceError: an entry was changed, left out or put in, or those up to a noted one are not there any more.

    """
    with database.reading() as session:
        return verify_entries(store.everything(session), *noted)


def verify_entries(entries: Iterable[AuditRecord], *noted: Head) -> Head:
    """Return the last of entries that continue each other; raises as `verify` does."""
    head, wanted = Head(0, ""), set(noted)
    for entry in entries:
        expected = (head.number + 1, head.sha256, hash_entry(entry.previous, entry.content))
        if (entry.number, entry.previous, entry.sha256) != expected or _parse_entry_number(
            entry.content
        ) != entry.number:
            raise _broken(f"Entry {head.number + 1} of the audit is not what was written, or is missing", head)
        head = Head(entry.number, entry.sha256)
        wanted.discard(head)
    if wanted:
        first = min(wanted)
        raise _broken(f"The audit does not hold entry {first.number} with the hash that was noted", head)
    return head


def _parse_entry_number(content: str) -> object:
    try:
        found = json.loads(content)
    except ValueError:
        return None
    return found.get("number") if isinstance(found, dict) else None


def _broken(what: str, head: Head) -> ServiceError:
    return ServiceError(
        f"{what}: somebody changed the database past Kilter, or it is damaged. Entries up to {head.number} are whole; "
        "compare with a backup.",
        code="audit_broken",
        whole_up_to=head.number,
    )


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
