"""What goes to stdout and stderr: one JSON document, text for people, and progress bars."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

from kilter_client.cli.terminal.name_words import name_ids, remember_names
from kilter_client.cli.terminal.tables import screen_columns, wrap_line
from kilter_client.errors import KilterError, UsageError
from kilter_client.requests.calls.jobs import AWAY
from kilter_client.verbs.progress import bars

Document = dict[str, Any]

REMEDY_FOR_COLUMNS = (
    "For a lab's own columns use --map columns.toml; "
    "`kilter measure inspect FILE --draft columns.toml` writes a first one."
)

INVALID = r"Invalid value for ((?:'[^']+'(?: / )?)+): (?:Value error, )?"  # an option with another name has both


def emit(document: Document, as_json: bool, show: Callable[[Document], None]) -> None:
    """Print a command's document: as JSON, or by ``show`` for people.

    Whoever reads may stop before the end, as ``head`` does: the exit code still says how the command ended.
    """
    remember_names(document)
    try:
        if as_json:
            print(json.dumps(document, indent=2, ensure_ascii=False))
        else:
            show(document)
        sys.stdout.flush()
    except BrokenPipeError:
        # What is buffered still would be written at the end, and fail there.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_line(text: str = "") -> None:
    """Print a line for people on stdout, as several where it is wider than a screen."""
    print("\n".join(wrap_line(name_ids(text), screen_columns())))


def print_lines(lines: Iterable[str]) -> None:
    """Print lines for people on stdout."""
    for line in lines:
        print_line(line)


def say_remarks(document: Document) -> None:
    """Print the notes and warnings of a document, a line each."""
    for text in document["notes"]:
        print_line(f"  {text}")
    for text in document["warnings"]:
        print_line(f"  Warning: {text}.")


def note(text: str, as_json: bool = False) -> None:
    """Print a line about what is being done, on stderr; nothing with --json."""
    if not as_json:
        print("\n".join(wrap_line(name_ids(text), screen_columns())), file=sys.stderr)


def report_error(error: KilterError, as_json: bool) -> None:
    """Print an error: its problem document on stdout with --json, else the sentence on stderr."""
    if as_json:
        print(json.dumps(error.to_document(), indent=2, ensure_ascii=False, default=str))
        return
    print("\n".join(wrap_line(f"Error: {error.detail}", screen_columns())), file=sys.stderr)
    if error.request_id and (error.status is None or error.status >= 500):
        print(f"Request {error.request_id}.", file=sys.stderr)


def report_usage(error: typer.TyperException, as_json: bool) -> None:
    """Print what was wrong with the command line, and where its help is."""
    if error.format_message().startswith("Usage: ") and not as_json:  # a group alone: what is in it
        print(error.format_message(), file=sys.stderr)
        return
    context = getattr(error, "ctx", None)
    hint = f" Try `{context.command_path} --help`." if context is not None else ""
    said = re.sub(INVALID, lambda found: found[1].replace("'", "") + ": ", error.format_message())
    said = said.replace(": Input should", ": it should")
    report_error(UsageError(said + ("" if said.endswith((".", "?", "!")) else ".") + hint), as_json)


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
