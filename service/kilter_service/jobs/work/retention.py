"""Jobs that ended long ago are purged: by a command, or by the worker where a setting says after how many days."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from datetime import datetime, timedelta

from kilter_service.ground.caller import on_behalf
from kilter_service.ground.db import Database
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.work import store

log = logging.getLogger("kilter.worker")

AT_ONCE = 50  # jobs in a transaction: others write in between
EVERY_S = 3600.0
AGE = re.compile(r"(\d{1,5})([hdw])")
UNITS = {"h": timedelta(hours=1), "d": timedelta(days=1), "w": timedelta(weeks=1)}


def parse_age(text: str) -> timedelta:
    """Read an age: 12h, 30d or 8w.

    Raises:
        ServiceError: it is not written so.

    """
    found = AGE.fullmatch(text.strip())
    if found is None or int(found[1]) == 0:
        raise ServiceError(f"--older-than is {text[:40]!r}: give an age such as 12h, 30d or 8w.", code="option_invalid")
    return int(found[1]) * UNITS[found[2]]


def purge(database: Database, older_than: timedelta, route: str) -> int:
    """Delete the jobs that ended longer ago than an age and that nothing needs; returns how many."""
    before, count = utc_now() - older_than, 0
    while found := _purge_batch(database, before, route):
        count += found
    return count


def count(database: Database, older_than: timedelta, most: int = 100_000) -> int:
    """Return how many jobs would be deleted."""
    with database.reading() as session:
        return len(store.ended_before(session, utc_now() - older_than, most))


def _purge_batch(database: Database, before: datetime, route: str) -> int:
    with on_behalf({"actor": "kilterd", "role": "admin"}, route, {}), database.transaction() as session:
        ids = store.ended_before(session, before, AT_ONCE)
        if ids:
            store.remove_jobs(session, ids)
        return len(ids)


class Retention:
    """What a worker does about jobs that ended long ago: every hour, fifty at a time."""

    def __init__(self, database: Database, days: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._database, self._days, self._clock = database, days, clock
        self._next_s = clock()

    def purge_if_due(self) -> None:
        """Purge some when it is time; a database that is away or full is asked again later."""
        if not self._days or self._clock() < self._next_s:
            return
        try:
            found = _purge_batch(self._database, utc_now() - timedelta(days=self._days), "kilterd worker")
        except Exception as error:
            if in_words(error) is None:
                raise
            found = 0
        if found:
            log.info("%d jobs that ended more than %d days ago were purged", found, self._days)
        if found < AT_ONCE:
            self._next_s = self._clock() + EVERY_S
