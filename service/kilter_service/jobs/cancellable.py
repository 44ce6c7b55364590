"""Long computations that a cancel leaves at once: the longest step of a gap search takes longer than a person waits."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from kilter_core.errors import CancelledError
from kilter_service.jobs.kind import Progress

T = TypeVar("T")

LOOK_S = 0.25


def cancellable(compute: Callable[[Progress], T], progress: Progress) -> T:
    """Run ``compute(progress)`` in a thread and report its progress several times a second.

    When the job is cancelled this raises at once; the thread ends when it reports progress the next time.

    Raises:
        CancelledError: the job was cancelled. Whatever ``compute`` raises.

    """
    work = _Work(compute)
    thread = threading.Thread(target=work, name="cancellable", daemon=True)
    thread.start()
    try:
        running = True
        while running:
            thread.join(LOOK_S)
            running = thread.is_alive()
            progress(*work.latest)
    except BaseException:
        work.stop.set()
        raise
    return work.outcome()


class _Work(Generic[T]):
    """The computation, how far it is, and how it ended."""

    def __init__(self, compute: Callable[[Progress], T]) -> None:
        self.stop = threading.Event()
        self.latest = (0.0, "starting")
        self._compute = compute
        self._done: list[T] = []
        self._error: BaseException | None = None

    def __call__(self) -> None:
        try:
            self._done.append(self._compute(self._report))
        except BaseException as error:  # raised again where it is waited for
            self._error = error

    def outcome(self) -> T:
        if self._error is not None:
            raise self._error
        return self._done[0]

    def _report(self, fraction: float, stage: str) -> None:
        self.latest = (fraction, stage)
        if self.stop.is_set():
            raise CancelledError("The job was cancelled.")
