"""What all rooms share: types of arrays, whose shapes docstrings state, callbacks of long computations, and one number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

QUANTILE = 1.959963984540054
"""Standard deviations of half a 95 % interval: the quantile of the standard normal at 97.5 %."""

Progress = Callable[[float, str], None]
"""Hears the share done (0 to 1) and the stage in words; it may raise to cancel."""


Task = TypeVar("Task")
Answer = TypeVar("Answer")


class Each(Protocol):
    """Applies a computation to independent tasks. Both can be sent to another process, whose answer is the same."""

    def __call__(
        self, work: Callable[[Task, Progress], Answer], tasks: Sequence[Task], progress: Progress
    ) -> list[Answer]:
        """Return the answers in the order of the tasks; the stages that ``progress`` hears begin with "2 of 5"."""
        ...


def run_sequentially(
    work: Callable[[Task, Progress], Answer],
    tasks: Sequence[Task],
    progress: Progress,
    done: int = 0,
    total: int | None = None,
) -> list[Answer]:
    """Compute the tasks here, one after the other: all of them, or those that follow ``done`` others of a ``total``."""
    found, total = [], total or len(tasks)
    for k, task in enumerate(tasks, done):
        progress(k / total, f"{k + 1} of {total}")
        found.append(work(task, _task_progress(progress, k, total)))
    return found


def _task_progress(progress: Progress, k: int, n: int) -> Progress:
    return lambda fraction, stage: progress((k + fraction) / n, f"{k + 1} of {n}, {stage}")


def unheard(fraction: float, stage: str) -> None:
    """Ignore the progress."""
