"""Rows of the audit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from sqlalchemy import select

from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import AuditRow
from kilter_service.ground.paging import ALL, Page

AT_ONCE = 500


class AuditRecord(NamedTuple):
    """An entry as it is stored."""

    number: int
    previous: str
    sha256: str
    content: str


def entries_on_page(session: Session, page: Page = ALL) -> list[AuditRecord]:
    """Return entries, oldest first, one more than the page shows."""
    row = AuditRow
    query = select(row.number, row.previous, row.sha256, row.content).order_by(row.number)
    if page.number is not None:
        query = query.where(row.number > page.number)
    return [AuditRecord(*found) for found in session.execute(query.limit(page.fetch_limit))]


def everything(session: Session) -> Iterator[AuditRecord]:
    """Yield all entries, oldest first, few at a time."""
    row = AuditRow
    query = select(row.number, row.previous, row.sha256, row.content).order_by(row.number)
    with session.execute(
        query.execution_options(yield_per=AT_ONCE)
    ) as entries:  # ended also where a reader stops half-way
        yield from (AuditRecord(*found) for found in entries)
