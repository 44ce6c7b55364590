"""`kilterd worker`: the process that executes jobs, and its thread that takes one after the other.

Jobs that ended long ago are purged: by a command, or by the worker where a setting says after how many days.
"""

from __future__ import annotations

import fcntl
import logging
import os
import re
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from kilter_core.errors import CoreError
from kilter_service.ground.backup_folder import wait_for_migration
from kilter_service.ground.caller import on_behalf
from kilter_service.ground.child_process import stop_event
from kilter_service.ground.db import Database, DatabaseAwayError, revision
from kilter_service.ground.db.database import Lookout
from kilter_service.ground.db.failures import in_words, log_failure
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.memory import set_out_of_memory_score
from kilter_service.ground.settings import Settings
from kilter_service.ground.webhook import Webhook
from kilter_service.jobs.fan_out import fan_out
from kilter_service.jobs.registry import KINDS
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import CreepingPosts, Runner
from kilter_service.jobs.work.store import Claim
from kilter_service.web import store as health

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


LOOK_S = 0.1

consumer_log = logging.getLogger("kilter.worker")
POLL_S = 0.2
PAUSE_S = 2.0  # after something that should not happen


@contextmanager
def single_worker_lock(database_file: Path, wait_s: float) -> Iterator[None]:
    """Hold the lock beside the database file.

    Raises:
        ServiceError: another process still holds it after ``wait_s``; one that was asked to stop needs a moment.

    """
    database_file.parent.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + wait_s
    with database_file.with_name(f"{database_file.name}.worker.lock").open("w", encoding="ascii") as file:
        while not _try_lock(file.fileno()):
            if time.monotonic() > deadline:
                raise ServiceError(
                    f"Another process runs the jobs of {database_file} (a `kilterd worker`, or the one of `kilterd "
                    "serve`), and a SQLite database has one only. Stop it first; for several workers set "
                    "KILTER_DATABASE_URL to a PostgreSQL database.",
                    code="jobs_taken",
                )
            time.sleep(LOOK_S)
        yield


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


class Watch:
    """Sees heartbeats change, or not."""

    def __init__(self, silent_after_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._after, self._clock = silent_after_s, clock
        self._seen: dict[str, tuple[datetime, float]] = {}

    def silent(self, beats: Mapping[str, datetime]) -> dict[str, datetime]:
        """Return the workers whose heartbeat has not changed for long, and that heartbeat."""
        time_s = self._clock()
        for name, at in beats.items():
            if name not in self._seen or self._seen[name][0] != at:
                self._seen[name] = (at, time_s)
        self._seen = {name: seen for name, seen in self._seen.items() if name in beats}
        return {name: at for name, (at, since) in self._seen.items() if time_s - since > self._after}

    def forget(self) -> None:
        """Begin anew: nobody could write a heartbeat while the database was away."""
        self._seen = {}


log = logging.getLogger("kilter.worker")

BEAT_S = 2.0
SILENT_S = 15.0  # a worker whose heartbeat has not changed for this long is gone; beats come late on a busy machine
CHECK_S = 10.0  # how often the revision of the database is looked at
MIGRATION_WAIT_S = 30.0
SETTLE_S = 2.0  # for verdicts that are being posted when a worker ends
ENDS_BEFORE = 500  # of the kernel's scores: its jobs are queued again, a corrector's arm is not corrected meanwhile
LOCK_WAIT_S = 10.0  # the worker of a server that was killed needs a moment to notice


def run(settings: Settings) -> None:
    """Execute jobs until SIGTERM or SIGINT; a job that is cut off goes back into the queue.

    Raises:
        ServiceError: another process runs the jobs of this SQLite database, or the database is of another revision.

    """
    set_out_of_memory_score(ENDS_BEFORE)
    stop = stop_event()
    wait_for_migration(settings.data)
    database = Database(settings.database)
    with alone(settings):
        revision.wait(database, MIGRATION_WAIT_S)
        code = _execute(settings, database, stop)
        # A thread inside a long computation cannot be joined; its job is in the queue again.
        logging.shutdown()
        os._exit(code)


def alone(settings: Settings, wait_s: float = LOCK_WAIT_S) -> AbstractContextManager[None]:
    """Hold what makes this the only worker, where there may be one only: on SQLite."""
    path = settings.sqlite_file
    return nullcontext() if path is None else single_worker_lock(Path(path), wait_s)


def _execute(settings: Settings, database: Database, stop: threading.Event) -> int:
    webhook = Webhook.from_settings(settings)
    member = Member(database, settings.worker_name or socket.gethostname(), webhook)
    member.join(alone=settings.sqlite_file is not None)
    each = fan_out(settings.worker_processes, settings.dask)
    for queue in settings.worker_queues:
        kinds = [kind.name for kind in KINDS.values() if kind.queue == queue]
        runner = Runner(database, stop, each, webhook)
        QueueConsumer(database, runner, member.id, kinds, stop).start(queue)
    log.info("worker %s takes jobs: %s", member.id, ", ".join(settings.worker_queues))
    retention = Retention(database, settings.keep_jobs_days)
    creeping = None if webhook is None else CreepingPosts(database, webhook)
    try:
        while not stop.wait(BEAT_S):
            member.beat()
            retention.purge_if_due()
            if creeping is not None:
                creeping.post_changes_if_due()
    except ServiceError as error:
        log.error("worker %s ends: %s", member.id, error.message)
        return 1
    finally:
        stop.set()
        if webhook is not None:
            webhook.settle(SETTLE_S)
        member.leave()
    return 0


class Member:
    """This process among the workers: it says that it lives, and notices those that do not."""

    def __init__(self, database: Database, name: str, webhook: Webhook | None = None) -> None:
        # Unique: of two workers with one name each must be missed, and a restarted one does not hold what it held.
        self.id = f"{name[:180]}-{uuid.uuid4().hex[:8]}"
        self._database, self._webhook = database, webhook
        self._watch = Watch(SILENT_S)
        self._away = False
        self._check_at = 0.0

    def join(self, *, alone: bool) -> None:
        """Say so the first time. Where there is one worker only, whatever ran before has ended."""
        with self._database.transaction() as session:
            if alone:
                store.bury(session, store.beats(session))
            health.beat(session, store.WORKER, self.id, os.getpid(), self._details())
            if back := store.orphans(session):
                log.warning("queued again, their worker had ended: %s", ", ".join(back))

    def beat(self) -> None:
        """Say that this worker lives, and put the jobs of silent ones back.

        Raises:
            ServiceError: the database was migrated: this code would not understand it.

        """
        try:
            with self._database.transaction() as session:
                health.beat(session, store.WORKER, self.id, os.getpid(), self._details())
            if time.monotonic() > self._check_at:
                revision.check(self._database)
                self._check_at = time.monotonic() + CHECK_S
            self._sweep()
        except DatabaseAwayError as error:
            self._wait(error)
            return
        except ServiceError:
            raise
        except Exception as error:  # the disk is full, say
            known = in_words(error)
            if known is None:
                raise
            self._wait(known)
            return
        if self._away:
            log.warning("the database answers and is written to again")
        self._away = False

    def _details(self) -> dict[str, Any]:
        return {} if self._webhook is None else {"webhook": dict(self._webhook.counts)}

    def _wait(self, error: CoreError) -> None:
        if not self._away:
            log.warning("%s This worker goes on when that is over.", error.message)
        self._away = True
        self._watch.forget()

    def _sweep(self) -> None:
        with self._database.reading() as session:
            beats, holders = store.beats(session), store.holders(session)
        silent = self._watch.silent({name: at for name, at in beats.items() if name != self.id})
        if not silent and holders <= set(beats):
            return
        with self._database.transaction() as session:
            store.bury(session, silent)
            back = store.orphans(session)
        for name in silent:
            log.warning("worker %s has been silent for %.0f s", name, SILENT_S)
        if back:
            log.warning("queued again, their worker has ended: %s", ", ".join(back))

    def leave(self) -> None:
        """Give back what this worker has; when that cannot be written, the others notice its silence."""
        try:
            with self._database.transaction() as session:
                health.silence(session, store.WORKER, self.id)
                store.give_back(session, self.id)
        except DatabaseAwayError:
            log.warning("worker %s could not say that it ends", self.id)


class QueueConsumer:
    """Claims jobs of some kinds and runs them, until ``stop``."""

    def __init__(
        self, database: Database, runner: Runner, worker: str, kinds: Sequence[str], stop: threading.Event
    ) -> None:
        self._database, self._runner, self._worker, self._stop = database, runner, worker, stop
        self._kinds = kinds
        # Many workers may ask; only one at a time may change.
        self._lookout = Lookout(database, store.query_for_free_jobs(kinds, worker))

    def start(self, name: str) -> None:
        """Begin, in a thread that ends with the process."""
        threading.Thread(target=self._work, name=f"jobs-{name}", daemon=True).start()

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                claim = self._claim_next_job()
                if claim is not None:
                    self._runner.run(claim)
                    continue
                pause = POLL_S
            except DatabaseAwayError:  # the thread that writes the heartbeat says so
                pause = PAUSE_S
            except Exception as error:  # one job, or one moment, must not end the queue
                log_failure(consumer_log, error, "worker %s goes on", self._worker)
                pause = PAUSE_S
            self._stop.wait(pause)

    def _claim_next_job(self) -> Claim | None:
        if not self._lookout.rows():
            return None
        with self._database.transaction() as session:
            return None if self._stop.is_set() else store.claim(session, self._worker, self._kinds)
