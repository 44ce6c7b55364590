"""Independent parts on an executor, with progress and cancel: the same answers in the same order, whatever computes them."""

from __future__ import annotations

import pickle
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from kilter_core.errors import CoreError
from kilter_core.types import run_sequentially, unheard
from kilter_service.ground.version import code_version
from kilter_service.jobs.fan_out.engine import Engine, Opened
from kilter_service.jobs.kind import Progress

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
