"""Independent parts of a job in several processes of the worker, with progress and cancel."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from kilter_service.jobs.kind import Progress

Task = TypeVar("Task")
Answer = TypeVar("Answer")

LOOK_S = 0.25  # how often progress is told, and so a cancel noticed
START_S = 5.0  # a process imports the core and loads its compiled code


class Processes:
    """Computes parts in ``count`` processes, where that is quicker than here."""

    def __init__(self, count: int) -> None:
        self._count = count

    def __call__(
        self, work: Callable[[Task, Progress], Answer], tasks: Sequence[Task], progress: Progress
    ) -> list[Answer]:
        """Return the answers in the order of the tasks. How long the first takes here decides where the others go.

        Raises:
            CancelledError: ``progress`` did. Whatever ``work`` raises.

        """
        from kilter_core.types import one_by_one  # numpy: not at the start of the API process

        if not tasks:
            return []
        n, begun = len(tasks), time.perf_counter()
        first = one_by_one(work, tasks[:1], lambda f, stage: progress(f / n, stage.replace("1 of 1", f"1 of {n}", 1)))
        rest = (time.perf_counter() - begun) * (n - 1)
        count = min(self._count, n - 1)
        if count < 2 or rest < START_S + rest / count:
            after = one_by_one(work, tasks[1:], _later(progress, n))
            return first + after
        with _started(count) as connections:
            return first + _spread(connections, work, tasks[1:], _later(progress, n))


def _later(progress: Progress, n: int) -> Progress:
    """Progress of all tasks but the first as part of all ``n``."""

    def tell(fraction: float, stage: str) -> None:
        number, _, words = stage.partition(" of ")
        words = words.partition(", ")[2]
        progress((1 + fraction * (n - 1)) / n, f"{int(number) + 1} of {n}" + (f", {words}" if words else ""))

    return tell


def _spread(
    connections: list[Connection], work: Callable[[Task, Progress], Answer], tasks: Sequence[Task], progress: Progress
) -> list[Answer]:
    answers: dict[int, Answer] = {}
    waiting = list(enumerate(tasks))[::-1]
    busy: dict[Connection, int] = {}
    while len(answers) < len(tasks):
        for free in [one for one in connections if one not in busy][: len(waiting)]:
            k, task = waiting.pop()
            free.send((work, task))
            busy[free] = k
        progress(len(answers) / len(tasks), f"{min(len(answers) + 1, len(tasks))} of {len(tasks)}")
        for ready in wait(list(busy), LOOK_S):
            assert isinstance(ready, Connection)
            answers[busy.pop(ready)] = _answer(ready)
    return [answers[k] for k in range(len(tasks))]


def _answer(connection: Connection) -> Any:
    try:
        answer, error = connection.recv()
    except (EOFError, OSError):
        raise RuntimeError("A process that computed a part of the job has ended: the memory may be full.") from None
    if error is not None:
        raise error
    return answer


@contextmanager
def _started(count: int) -> Iterator[list[Connection]]:
    context = multiprocessing.get_context("spawn")  # this process has threads: a fork of it might wait for ever
    pipes = [context.Pipe() for _ in range(count)]
    processes = [context.Process(target=_serve, args=(theirs,), daemon=True) for _, theirs in pipes]
    try:
        for process, (_, theirs) in zip(processes, pipes, strict=True):
            process.start()
            theirs.close()
        yield [ours for ours, _ in pipes]
    finally:
        for process, (ours, _) in zip(processes, pipes, strict=True):
            ours.close()
            if process.pid is not None:
                process.terminate()
                process.join()


def _serve(connection: Connection) -> None:
    """Compute what comes through the connection; ends when the worker has, however it ended."""
    from kilter_core.types import unheard

    while True:
        try:
            work, task = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer: tuple[Any, Exception | None] = (work(task, unheard), None)
        except Exception as error:  # raised again in the worker
            answer = (None, error)
        try:
            connection.send(answer)
        except OSError:
            return
