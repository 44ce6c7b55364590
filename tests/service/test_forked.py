"""Processor time of forked processes counts while they run: the server of a session ends after the last test."""

from __future__ import annotations

from tests.service import forked
from tests.service.conftest import WorkerProcess


def test_what_a_process_that_still_runs_took_is_counted_once(worker: WorkerProcess) -> None:
    before_s = forked.used_s()
    worker.start()
    running_s = forked.used_s()
    assert before_s < running_s  # it connected to its database and said that it is alive
    worker.stop()
    assert running_s <= forked.used_s() < running_s + 20.0
