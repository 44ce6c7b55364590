"""How a process beside the API says that it is alive."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

from kilter_files.ground.later import later
from kilter_service.ground.backup_folder import is_migrating
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.settings import Settings

with later(__name__):
    from kilter_service.ground import db
    from kilter_service.ground.db import revision
    from kilter_service.web import store

log = logging.getLogger("kilter.health")

BEAT_S = 2.0
STUCK_S = 10.0  # a loop that has not gone round for so long is stuck


class Pulse:
    """Says in the database that a process is alive, for as long as its loop goes round and ``well`` says so.

    It has a thread of its own: a database that is slow or away never holds up the process.
    """

    def __init__(
        self,
        settings: Settings,
        process: str,
        name: str,
        well: Callable[[], bool] = lambda: True,
        details: Callable[[], dict[str, Any]] = dict,
    ) -> None:
        self._settings, self._process, self._name, self._well, self._details = settings, process, name, well, details
        self._ended, self._round_at = threading.Event(), time.monotonic()
        self._said, self._migrated = False, False
        self._telling = Failing(log, "%s cannot say in the database that it is alive", process)
        self._thread = threading.Thread(target=self._run, name=f"pulse of {process}", daemon=True)

    def __enter__(self) -> Pulse:
        self._thread.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(BEAT_S)

    def round(self) -> None:
        """Say that the loop of the process went round."""
        self._round_at = time.monotonic()

    def _run(self) -> None:
        database = db.Database(self._settings.database)
        while not self._ended.wait(BEAT_S if self._said else 0.0):
            self._said = True
            if self._well() and time.monotonic() - self._round_at < STUCK_S:
                self._write_heartbeat(database, stopped=False)
        self._write_heartbeat(database, stopped=True)
        database.close()

    def _write_heartbeat(self, database: db.Database, *, stopped: bool) -> None:
        try:
            # Before the tables are there, as while a new server makes them, the check of the database says what is missing.
            if not self._migrated and is_migrating(self._settings.data):
                return
            self._migrated = self._migrated or revision.current(database) == revision.HEAD
            if not self._migrated:
                return
            with database.transaction() as session:
                if stopped:
                    store.silence(session, self._process, self._name)
                else:
                    store.beat(session, self._process, self._name, os.getpid(), self._details())
            self._telling.report_success()
        except Exception as error:  # whatever the database says, the process goes on
            self._telling.report_failure(error)
