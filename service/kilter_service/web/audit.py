"""Reading the audit, and whether it is whole."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from kilter_service.contract.tokens import AuditEntry, AuditPage
from kilter_service.ground.db import Database
from kilter_service.ground.db.audited import hash_entry
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.web import store
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
