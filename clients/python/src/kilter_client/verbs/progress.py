"""How far a job or an upload is: a bar where somebody watches, or whatever the caller wants to be told.

Errors in terms of a script: its verbs and their arguments.

The server speaks of requests ("options.level", "GET /v1/..."), and of the command ("--role confirmation"), which whoever
wrote ``k.identify(..., level=7)`` did not type.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from kilter_client.errors import KilterError

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


ROUTES: Mapping[str, str] = {
    "GET /v1/jobs": "k.jobs()",
    "GET /v1/robots": "k.robots()",
    "GET /v1/robots/{robot}/campaigns": "k.campaigns(robot)",
    "GET /v1/robots/{robot}/versions": "k.versions(robot)",
    "POST /v1/robots": "k.add_robot(...)",
    "POST /v1/versions/{id}/activate": "k.activate(version)",
}
ROUTE = re.compile(r"\b(?:GET|POST|PATCH|PUT|DELETE) /v1/[\w/{}.-]*[\w}]")
# Arguments that a verb calls otherwise than the request or the command does.
OTHER_NAMES: Mapping[str, str] = {"format": "form", "map": "column_map", "remarks": "notes"}
REWORDED: Sequence[tuple[str, str]] = (
    (r"kilter (?:(?:measure )?campaigns|versions?) (retire|restore) (\w+)", r'k.\1("\2")'),
    (r"kilter robot (retire|restore) ([\w.-]+)", r'k.\1("\2", kind="robot")'),
    (r"kilter (?:server )?jobs watch (\w+)", r'k.wait("\1")'),
    (r"kilter robot add", "k.add_robot(...)"),
    (r'kilter activate --force --reason TEXT`, \{"force": true, "reason": TEXT\}', "force=True, reason=...`"),
    (r"kilter (?:version |server )?(upload|identify|gap|evaluate|plan|activate|correct|export|jobs)\b", r"k.\1"),
)
PLACE = re.compile(r"\b(?:options|body|query)\.(\w+)")
OPTION = re.compile(
    r"--([a-z]+(?:-[a-z0-9]+)*)(?: (\w+\.toml|(?:cmp|ver|job)_\w+|confirmation|validation|train|same|coupled))?"
)
COMMANDS = re.compile(r"(`kilterd? (?:(?:measure )?inspect|serve\b)[^`]*`)")  # they are for a terminal here too


def rephrase_error(error: KilterError) -> None:
    """Put the sentence of an error in the words of a script."""
    error.detail = in_words(error.detail)
    error.args = (error.detail,)


def in_words(sentence: str) -> str:
    """Return a sentence with verbs for routes and commands, and arguments for places and options."""
    parts = COMMANDS.split(sentence)
    return "".join(part if k % 2 else _in_words(part) for k, part in enumerate(parts))


def _in_words(text: str) -> str:
    text = ROUTE.sub(lambda found: ROUTES.get(found[0], "another verb"), text)
    for pattern, words in REWORDED:
        text = re.sub(pattern, words, text)
    text = PLACE.sub(lambda found: _name(found[1]), text)
    return OPTION.sub(lambda found: f"{_name(found[1])}={_value(found[2])}", text)


def _name(name: str) -> str:
    plain = name.replace("-", "_")
    return OTHER_NAMES.get(plain, plain)


def _value(value: str | None) -> str:
    return "" if value is None else f'"{value}"'
