"""What an engine is: where parts are computed. It opens a ``concurrent.futures.Executor`` for as long as it is needed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


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
