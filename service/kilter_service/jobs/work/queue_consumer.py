"""A thread of a worker that takes one job after the other from a queue."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence

from kilter_service.ground.db import Database, DatabaseAwayError
from kilter_service.ground.db.lookout import Lookout
from kilter_service.ground.failure_log import log_failure
from kilter_service.jobs.lease import store as lease
from kilter_service.jobs.lease.store import Claim
from kilter_service.jobs.work.runner import Runner

log = logging.getLogger("kilter.worker")

POLL_S = 0.2
PAUSE_S = 2.0  # after something that should not happen


class QueueConsumer:
    """Claims jobs of some kinds and runs them, until ``stop``."""

    def __init__(
        self, database: Database, runner: Runner, worker: str, kinds: Sequence[str], stop: threading.Event
    ) -> None:
        self._database, self._runner, self._worker, self._stop = database, runner, worker, stop
        self._kinds = kinds
        # Many workers may ask; only one at a time may change.
        self._lookout = Lookout(database, lease.query_for_free_jobs(kinds, worker))

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
                log_failure(log, error, "worker %s goes on", self._worker)
                pause = PAUSE_S
            self._stop.wait(pause)

    def _claim_next_job(self) -> Claim | None:
        if not self._lookout.rows():
            return None
        with self._database.transaction() as session:
            return None if self._stop.is_set() else lease.claim(session, self._worker, self._kinds)
