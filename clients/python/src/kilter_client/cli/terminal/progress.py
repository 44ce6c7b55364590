"""Progress bars on stderr, only on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from kilter_client.cli.terminal.output import note
from kilter_client.requests.calls.jobs import AWAY
from kilter_client.verbs.progress import bars


@contextmanager
def upload_bar(name: str, as_json: bool, doing: str = "sending") -> Iterator[Callable[[int, int], None]]:
    """Show how much is done of the total: bytes sent, or what else is being done."""
    if as_json or not sys.stderr.isatty():
        yield lambda sent, total: None
        return
    with bars(stderr=True) as bar:
        task = bar.add_task(f"{doing} {name}", total=None)
        yield lambda sent, total: bar.update(task, completed=sent, total=total)


@contextmanager
def job_bar(name: str, as_json: bool) -> Iterator[Callable[[float, str], None]]:
    """Show the fraction and the stage of a job; where nobody watches a bar, say once that the server is away."""
    if as_json or not sys.stderr.isatty():
        yield _said_once(name, as_json)
        return
    with bars(stderr=True) as bar:
        task = bar.add_task(name, total=1.0)
        yield lambda fraction, stage: bar.update(task, completed=fraction, description=f"{name}: {stage}")


def _said_once(name: str, as_json: bool) -> Callable[[float, str], None]:
    said: set[str] = set()

    def note_stage_once(_: float, stage: str) -> None:
        if stage == AWAY and stage not in said:
            said.add(stage)
            note(f"{name}: {stage}", as_json)

    return note_stage_once
