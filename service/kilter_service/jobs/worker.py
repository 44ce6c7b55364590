"""`kilterd worker`: the process that executes jobs."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from typing import TYPE_CHECKING

from kilter_service.db import Database, revision
from kilter_service.health import store as health
from kilter_service.jobs import store
from kilter_service.jobs.engine_clock import keep_time
from kilter_service.jobs.engine_rows import json_only
from kilter_service.jobs.queue import APPLICATION, APPLICATION_VERSION, LONG_QUEUE, QUEUE, WORKFLOW, EngineRow, JobQueue
from kilter_service.jobs.registry import kind_of
from kilter_service.jobs.runner import Outcome, Runner
from kilter_service.settings import Settings

if TYPE_CHECKING:
    from dbos import DBOSConfig

log = logging.getLogger("kilter.worker")

BEAT_S = 1.0
QUEUE_POLL_S = 0.2
FOUND_AFTER_S = 3.0  # a job the API could not hand to the engine is found by the sweep after this
MIGRATION_WAIT_S = 30.0


def run(settings: Settings) -> None:
    """Execute jobs until SIGTERM or SIGINT; a job that is cut off goes on at the next start."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    database = Database(settings.database)
    revision.wait(database, MIGRATION_WAIT_S)
    name = settings.worker_name or socket.gethostname()
    _launch(settings, Runner(database), name)
    queue = JobQueue(settings)
    if older := queue.forget_older():
        log.warning("jobs of an older Kilter are restarted: %s", ", ".join(older))
    while not stop.is_set():
        _beat(database, name)
        _sweep(database, queue)
        stop.wait(BEAT_S)
    with database.transaction() as session:
        health.silence(session, "worker", name)
    # A thread inside a long computation cannot be joined; its job is durable and goes on at the next start.
    logging.shutdown()
    os._exit(0)


def _launch(settings: Settings, runner: Runner, name: str) -> None:
    from dbos import DBOS

    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.jobs_database,
        "application_version": APPLICATION_VERSION,
        # A worker resumes the jobs of its own name only, so the name must be the same after a restart.
        "executor_id": name,
        "log_level": "WARNING",
        "notification_listener_polling_interval_sec": 0.5,
        "serializer": json_only(),
    }
    keep_time()
    DBOS(config=config)

    @DBOS.step(name="compute")
    def compute(job_id: str) -> Outcome:
        return runner.compute(job_id)

    @DBOS.step(name="finish", retries_allowed=True, max_attempts=5)
    def finish(job_id: str, outcome: Outcome) -> None:
        runner.finish(job_id, outcome)

    @DBOS.workflow(name=WORKFLOW)
    def job(job_id: str) -> None:
        finish(job_id, compute(job_id))

    DBOS.launch()
    for queue in (QUEUE, LONG_QUEUE):
        DBOS.register_queue(queue, worker_concurrency=1, polling_interval_sec=QUEUE_POLL_S)
    log.info("worker %s takes jobs", name)


def _beat(database: Database, name: str) -> None:
    with database.transaction() as session:
        health.beat(session, "worker", name, os.getpid())


def _sweep(database: Database, queue: JobQueue) -> None:
    """Hand over jobs the engine does not know, and close those it gave up."""
    with database.reading() as session:
        waiting = store.unfinished(session, FOUND_AFTER_S)
    for job_id, kind in waiting:
        row = queue.row(job_id)
        if row is None:
            log.warning("job %s was missing from the queue and has been queued", job_id)
            queue.enqueue(job_id, long=kind_of(kind).long)
        elif row.status == "CANCELLED":
            with database.transaction() as session:
                store.cancel(session, job_id)
        elif message := _given_up(job_id, row):
            log.error("job %s: %s", job_id, message)
            with database.transaction() as session:
                store.fail(session, job_id, "internal_error", message)
            if not row.readable:
                queue.forget(job_id)


def _given_up(job_id: str, row: EngineRow) -> str | None:
    """Why the engine will never finish a job; None when it may."""
    if not row.readable:
        return (
            f"The row of job {job_id} in the jobs database was changed or is in a format that Kilter does not read. "
            "Give the job again, and check who can write to that database."
        )
    if row.status in ("ERROR", "MAX_RECOVERY_ATTEMPTS_EXCEEDED"):
        cause = f": {row.error}" if row.error else "."
        return f"The job engine gave up the job ({row.status}){cause} The worker's log has more under job {job_id}."
    return None
