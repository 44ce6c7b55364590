"""The engine by default: processes of the worker, on its own machine."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

from kilter_service.jobs.fan_out.engine import Opened

START_S = 5.0  # a process imports the core and loads its compiled code


class LocalProcesses:
    """Up to ``count`` processes, started for one set of parts and ended with it."""

    tries_first = True

    def __init__(self, count: int) -> None:
        self._count = count

    def pays(self, parts: int, each_s: float) -> bool:
        """Whether the start of the processes costs less than they save."""
        count = min(self._count, parts)
        return count > 1 and parts * each_s > START_S + parts * each_s / count

    @contextmanager
    def open_executor(self, parts: int) -> Iterator[Opened]:
        """Start processes. Parts travel in files: a process that is killed can leave no half of one in a shared pipe."""
        context = multiprocessing.get_context("spawn")  # this process has threads: a fork of it might wait for ever
        theirs, ours = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(min(self._count, parts), context, exit_when_closed, (theirs,))
        with tempfile.TemporaryDirectory(prefix="kilter-parts-") as folder:
            try:
                yield Opened(pool, Path(folder))
            finally:
                ours.close()  # which ends the processes, busy or not
                pool.shutdown(wait=True, cancel_futures=True)
                theirs.close()


def exit_when_closed(other: Connection) -> None:
    """End this process when the other end of the connection is closed: its owner is done, or was killed."""
    threading.Thread(target=_wait_and_exit, args=(other,), name="end-with-worker", daemon=True).start()


def _wait_and_exit(other: Connection) -> None:
    try:
        other.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
