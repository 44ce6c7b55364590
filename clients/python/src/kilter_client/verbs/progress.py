"""How far a job or an upload is: a bar where somebody watches, or whatever the caller wants to be told."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress

Told = Callable[[float, str], None]
# True: a bar on a terminal or in a notebook; False: nothing; a function: it is told the fraction done and the stage.
Watching = bool | Told


@contextmanager
def show_progress(progress: Watching, name: str) -> Iterator[Told | None]:
    """Give what is to be told of the progress; None: nobody watches."""
    if callable(progress):
        yield progress
        return
    if not progress or not somebody_watches():
        yield None
        return
    with _Bars() as bar:
        task = bar.add_task(name, total=1.0)
        try:
            yield lambda fraction, stage: bar.update(task, completed=fraction, description=f"{name}: {stage}")
        finally:
            bar.remove_task(task)


def somebody_watches() -> bool:
    """Whether stderr is a terminal, or this is a notebook."""
    return sys.stderr.isatty() or in_notebook()


def in_notebook() -> bool:
    """Whether this runs in a Jupyter kernel, which shows bars as they go."""
    interactive = sys.modules.get("IPython")
    shell: Any = interactive.get_ipython() if interactive is not None else None
    return shell is not None and shell.has_trait("kernel")


class _Bars:
    """The bars of all jobs that are waited for at once: a terminal can show one group of bars only."""

    _shown: Progress | None = None
    _used = 0

    def __enter__(self) -> Progress:
        kind = type(self)
        if kind._shown is None:
            kind._shown = bars(stderr=not in_notebook())
            kind._shown.start()
        kind._used += 1
        return kind._shown

    def __exit__(self, *_: object) -> None:
        kind = type(self)
        kind._used -= 1
        if kind._used == 0 and kind._shown is not None:
            kind._shown.stop()
            kind._shown = None


def bars(stderr: bool) -> Progress:
    """Return a group of bars that goes when all is done, on stderr or where the notebook shows it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=stderr),
        transient=True,
    )
