"""What an engine is: where parts are computed. It opens a ``concurrent.futures.Executor`` for as long as it is needed."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

START_S = 5.0  # a process imports the core and loads its compiled code


@dataclass(frozen=True)
class Opened:
    """An executor, and the folder through which parts travel to it; None: as bytes in its own messages.

    ``check()`` says what is waited for, "" while parts are computed; it raises a CoreError when they never will be.
    """

    executor: Executor
    folder: Path | None = None
    check: Callable[[], str] = lambda: ""


class Engine(Protocol):
    """Processes of this machine, or a cluster."""

    tries_first: bool
    """Whether the first part is computed here, because how long it takes decides where the others go."""

    def pays(self, parts: int, each_s: float) -> bool:
        """Whether so many parts, of which each takes so many seconds, are ready sooner there than here."""
        ...

    def open_executor(self, parts: int) -> AbstractContextManager[Opened]:
        """Open an executor. When the context ends, what is pending is cancelled, and nothing is waited for.

        Raises:
            CoreError: the engine is not there, or broke in a way that it cannot mend.

        """
        ...


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
