"""Entries of the audit as the page shows them."""

from __future__ import annotations

import json
from dataclasses import dataclass

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.audit import AuditEntry
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.page.audit.action_words import DONE, Said, describe_entries
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.versions import service as versions
from kilter_service.web.audit import service as audit

AT_ONCE = 1000


@dataclass(frozen=True)
class Found:
    """The entries that were asked for, newest first, how many there are in all, and whether the record is whole."""

    part: Part[AuditEntry]
    entries: list[Said]
    total: int
    head: str
    broken: str


def find_entries(database: Database, robot: str, actor: str, asked: Asked) -> Found:
    """Return entries about a robot, by somebody; empty texts ask for all."""
    ids = _ids(database, robot) if robot else frozenset()
    kept: list[AuditEntry] = []
    total = 0
    after: tuple[str, ...] | None = None
    while True:
        page = audit.list_entries(database, Page(AT_ONCE, after))
        total += len(page.entries)
        kept += [one for one in page.entries if _is_wanted(one, robot, ids, actor)]
        if page.next is None:
            break
        after = (str(page.entries[-1].number),)
    head, broken = _state(database)
    shown = select_page(kept[::-1], asked, _words, {})
    return Found(shown, describe_entries(database, shown.shown), total, head, broken)


def _words(entry: AuditEntry) -> str:
    """What a search looks in: what was done, and all that the entry holds."""
    return f"{DONE.get(entry.route, '')} {entry.content}"


def _state(database: Database) -> tuple[str, str]:
    """The last entry of a record that is whole, or what is wrong with it."""
    try:
        head = audit.verify(database)
    except ServiceError as error:
        return "", error.message
    return f"{head.number}:{head.sha256}", ""


def _is_wanted(entry: AuditEntry, robot: str, ids: frozenset[str], actor: str) -> bool:
    return (not actor or entry.actor == actor) and (not robot or _is_about(entry, robot, ids))


def _is_about(entry: AuditEntry, robot: str, ids: frozenset[str]) -> bool:
    """Whether an entry names a robot or what belongs to it: in its address, or in what it changed."""
    place = json.loads(entry.place)
    if isinstance(place, dict) and ids & {str(value) for value in place.values()}:
        return True
    quoted = json.dumps(robot)
    return any(quoted in one.after or quoted in one.before or ids & set(one.thing.split()) for one in entry.changes)


def _ids(database: Database, robot: str) -> frozenset[str]:
    """Names of a robot and of all that belongs to it; of one that is not there any more its own."""
    try:
        ids = [one.id for one in campaigns.list_campaigns(database, robot, Page(), with_retired=True).campaigns]
        ids += [one.id for one in versions.list_versions(database, robot, Page(), with_retired=True).versions]
        ids += [one.id for one in jobs.list_jobs(database, robot, Page()).jobs]
    except ServiceError:
        return frozenset({robot})
    return frozenset({robot, *ids})
