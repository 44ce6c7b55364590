"""Progress bars on stderr, only where somebody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from kilter_client.calls.jobs import AWAY
from kilter_client.cli.output import note

if TYPE_CHECKING:
    from rich.progress import Progress


@contextmanager
def upload_bar(name: str, as_json: bool) -> Iterator[Callable[[int, int], None]]:
    """Show the bytes sent."""
    with _bar(as_json) as bar:
        task = bar.add_task(f"sending {name}", total=None)
        yield lambda sent, total: bar.update(task, completed=sent, total=total)


@contextmanager
def job_bar(name: str, as_json: bool) -> Iterator[Callable[[float, str], None]]:
    """Show the fraction and the stage of a job; where nobody watches a bar, say once that the server is away."""
    said: set[str] = set()
    with _bar(as_json) as bar:
        task = bar.add_task(name, total=1.0)

        def show(fraction: float, stage: str) -> None:
            bar.update(task, completed=fraction, description=f"{name}: {stage}")
            if bar.disable and stage == AWAY and stage not in said:
                said.add(stage)
                note(f"{name}: {stage}", as_json)

        yield show


def _bar(as_json: bool) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=as_json or not sys.stderr.isatty(),
    )
