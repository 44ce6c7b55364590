"""Independent parts on an executor, with progress and cancel: the same answers in the same order, whatever computes them.

What an engine is: where parts are computed. It opens a ``concurrent.futures.Executor`` for as long as it is needed.

A Dask cluster as the engine: its scheduler gives the parts of a job to workers on other machines.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import platform
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from kilter_core.errors import CoreError
from kilter_core.types import run_sequentially, unheard
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import code_version
from kilter_service.jobs.kind import Progress

if TYPE_CHECKING:
    from distributed import Client


COUNTED = ("numpy", "scipy", "numba")  # packages whose release may change the last digit of a number
Packed = bytes | Path


@cache
def release() -> str:
    """Return what must be the same everywhere, or one part would be computed otherwise than the next."""
    packages = ", ".join(f"{name} {version(name)}" for name in COUNTED)
    return f"Kilter {code_version()}, Python {platform.python_version()}, {packages}"


def pack(work: Callable[..., Any], task: Any) -> bytes:
    """Return a part as bytes."""
    return pickle.dumps((work, task), pickle.HIGHEST_PROTOCOL)


def compute(packed: Packed, wanted: str) -> Packed:
    """Compute a part where ``release()`` is the ``wanted`` one; what came as a file is answered in another.

    The answer holds what the work returned, or the error that it raised.
    """
    answer = pickle.dumps(_run_packed_part(packed, wanted), pickle.HIGHEST_PROTOCOL)
    if isinstance(packed, bytes):
        return answer
    path = packed.with_suffix(".answer")
    path.write_bytes(answer)
    return path


def unpack(answer: Packed) -> Any:
    """Return what the work returned.

    Raises:
        Exception: what it raised.

    """
    found, error = pickle.loads(answer if isinstance(answer, bytes) else answer.read_bytes())  # noqa: S301 (our own)
    if error is not None:
        raise error
    return found


def _run_packed_part(packed: Packed, wanted: str) -> tuple[Any, Exception | None]:
    if release() != wanted:
        message = (
            f"The worker of the cluster on {platform.node()} has {release()}; the job is computed with {wanted}. "
            "Install the same there, and ask for the job again."
        )
        return None, CoreError(message, code="cluster_differs", worker=release(), wanted=wanted)
    try:
        work, task = pickle.loads(packed if isinstance(packed, bytes) else packed.read_bytes())  # noqa: S301 (our own)
        return work(task, unheard), None
    except Exception as error:  # raised again where the job runs
        return None, error


Task = TypeVar("Task")
Answer = TypeVar("Answer")
Work = Callable[[Task, Progress], Answer]

LOOK_S = 0.25  # how often progress is told, and so a cancel noticed
MOST_BREAKS = 3  # times that processes may end without an answer in between


class FanOut:
    """Computes parts on an engine. A part that was lost with its process is computed again."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def __call__(self, work: Work[Task, Answer], tasks: Sequence[Task], progress: Progress) -> list[Answer]:
        """Return the answers in the order of the tasks.

        Raises:
            CancelledError: ``progress`` did. Whatever ``work`` raises. CoreError: the engine cannot compute.

        """
        n = len(tasks)
        if not n:
            return []
        first: list[Answer] = []
        if self._engine.tries_first:
            begun = time.perf_counter()
            first = run_sequentially(work, tasks[:1], progress, total=n)
            if not self._engine.pays(n - 1, time.perf_counter() - begun):
                return first + run_sequentially(work, tasks[1:], progress, 1, n)
        left = tasks[len(first) :]
        found = dict(self.as_completed(work, left, _progress_of_parts(progress, len(first), n)))
        return first + [found[k] for k in range(len(left))]

    def as_completed(
        self,
        work: Work[Task, Answer],
        tasks: Sequence[Task],
        look: Callable[[int, str], None] = lambda done, state: None,
    ) -> Iterator[tuple[int, Answer]]:
        """Give each answer with the place of its task as soon as it is there.

        ``look(done, state)`` hears several times a second how many there are, and what is waited for; when it raises,
        what is pending is cancelled.
        """
        left, breaks = dict(enumerate(tasks)), 0
        while left:
            with self._engine.open_executor(len(left)) as opened:
                for k, answer in _round(opened, work, dict(left), _progress_from_waiting(look, len(tasks), opened)):
                    del left[k]
                    breaks = 0
                    yield k, answer
            breaks += 1
            if left and breaks == MOST_BREAKS:
                raise CoreError(
                    f"Processes that computed parts of the job have ended {breaks} times without an answer: the memory may "
                    "be full. Set a smaller KILTER_WORKER_PROCESSES, or give the machine more memory.",
                    code="part_ended",
                    parts=len(left),
                )


def _round(
    opened: Opened, work: Work[Task, Answer], tasks: Mapping[int, Task], look: Callable[[int], None]
) -> Iterator[tuple[int, Answer]]:
    """Answers of one executor, fewer than there are tasks when it broke; ``look`` hears how many are waited for."""
    places: dict[Future[Packed], int] = {}
    try:
        for k, task in tasks.items():
            places[opened.executor.submit(compute, _sent(opened, k, work, task), release())] = k
        waiting = set(places)
        while waiting:
            look(len(waiting))
            done, waiting = wait(waiting, LOOK_S, FIRST_COMPLETED)
            for future in sorted(done, key=_has_failed):
                yield places[future], unpack(future.result())
    except BrokenExecutor:
        return


def _has_failed(future: Future[Packed]) -> bool:
    return future.cancelled() or future.exception() is not None


def _progress_from_waiting(look: Callable[[int, str], None], n: int, opened: Opened) -> Callable[[int], None]:
    return lambda waiting: look(n - waiting, opened.check())


def _sent(opened: Opened, k: int, work: Work[Task, Answer], task: Task) -> Packed:
    packed = pack(work, task)
    if opened.folder is None:
        return packed
    path = opened.folder / f"{k}.part"
    path.write_bytes(packed)
    return path


def _progress_of_parts(progress: Progress, first: int, n: int) -> Callable[[int, str], None]:
    """What hears of the parts after the ``first`` ones of ``n``."""

    def report_progress(done: int, state: str) -> None:
        done += first
        progress(done / n, f"{min(done + 1, n)} of {n}" + (f", {state}" if state else ""))

    return report_progress


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


CONNECT_S = 10.0
AWAY_S = 5.0  # how long the connection may be gone before the job fails
CLOSE_S = 2.0
ASK_S, ANSWER_S = 2.0, 1.0  # between two questions for workers, and for an answer: a cancel must not wait longer


class DaskCluster:
    """The cluster whose scheduler listens at ``address``; every part goes there, and none is computed here.

    Raises:
        ServiceError: the package is missing.

    """

    tries_first = False

    def __init__(self, address: str) -> None:
        if find_spec("distributed") is None:
            raise ServiceError(
                f"KILTER_DASK names {address}, and a package is missing: pip install distributed, in the release that "
                "constraints.txt names, or unset KILTER_DASK.",
                code="cluster_away",
                address=address,
            )
        self._address = address

    def pays(self, parts: int, each_s: float) -> bool:
        """Return True: whoever names a cluster wants it to compute."""
        return True

    @contextmanager
    def open_executor(self, parts: int) -> Iterator[Opened]:
        """Connect to the scheduler for these parts alone, so that one that was restarted is found again by the next."""
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        client = self._connect_client()
        executor = client.get_executor(pure=False)  # or it would take the time to see which parts are equal
        try:
            yield Opened(executor, check=_Watch(client, self._unreachable_error))
        except (CancelledError, CommClosedError) as error:  # the scheduler has forgotten the parts
            raise self._unreachable_error() from error
        except RuntimeError as error:
            if not isinstance(error.__cause__, ImportError):
                raise
            raise CoreError(
                f"The scheduler of the cluster at {self._address} cannot read a part of the job: {error.__cause__}. Install "
                "the same Kilter for the scheduler as for its workers, and ask for the job again.",
                code="cluster_differs",
                address=self._address,
            ) from error
        except KilledWorker as error:
            raise CoreError(
                f"Workers of the cluster at {self._address} that computed a part of the job ended, one after the other: "
                f"their memory may be full. Give them more, and see their logs. ({error})",
                code="part_ended",
                address=self._address,
            ) from error
        finally:
            with suppress(Exception):  # a scheduler that is gone has nothing left to cancel
                executor.shutdown(wait=False)
            with suppress(Exception):
                client.close(timeout=CLOSE_S)

    def _connect_client(self) -> Client:
        from distributed import Client

        try:
            return Client(self._address, timeout=CONNECT_S, set_as_default=False, name="kilter")
        except (OSError, ValueError) as error:  # also a timeout
            raise self._unreachable_error() from error

    def _unreachable_error(self) -> CoreError:
        return ServiceError(
            f"The Dask scheduler at {self._address} does not answer. Start it, or correct KILTER_DASK, and ask for the job "
            "again; without KILTER_DASK the worker computes in processes of its own.",
            code="cluster_away",
            address=self._address,
        )


class _Watch:
    """Whether the scheduler is there, and somebody who computes."""

    def __init__(self, client: Client, away: Callable[[], CoreError]) -> None:
        self._client, self._away = client, away
        self._gone_at: float | None = None
        self._ask_at, self._state = 0.0, ""

    def __call__(self) -> str:
        now = time.monotonic()
        if self._client.status != "running":
            self._gone_at = self._gone_at or now
            if now - self._gone_at > AWAY_S:
                raise self._away()
            return "the scheduler is away"
        self._gone_at = None
        if now > self._ask_at:
            self._state = self._query_cluster_state()
            self._ask_at = time.monotonic() + ASK_S
        return self._state

    def _query_cluster_state(self) -> str:
        scheduler = self._client.scheduler
        assert scheduler is not None  # while it is connected
        try:
            known = self._client.sync(scheduler.identity, n_workers=1, callback_timeout=ANSWER_S)
        except (OSError, TimeoutError):
            return "the scheduler does not answer"
        return "" if known["workers"] else "the cluster has no workers yet"
