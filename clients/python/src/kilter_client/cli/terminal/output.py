"""What goes to stdout and stderr: one JSON document, text for people, and progress bars.

Notes that a person reads once in a session of work: which ones were shown is kept in a file of the person's own.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import typer

from kilter_client import Kilter
from kilter_client.errors import KilterError, NotFoundError, UsageError
from kilter_client.requests.calls.jobs import AWAY
from kilter_client.requests.calls.references import Kind
from kilter_client.requests.steps import Request, Steps, refuse
from kilter_client.verbs.progress import bars

ID = re.compile(r"\b(?:ver|cmp|job)_[0-9a-f]{16}\b")
KINDS: Mapping[str, Kind] = {"ver": "version", "cmp": "campaign", "job": "job"}
SHORT = 12  # characters of an id without a name: a reference all the same
ANSWER_S = 2.0  # a name is not worth a longer wait

_names: dict[str, str] = {}
_unasked = [True]  # empty: the server did not answer


def name_ids(text: str, versions_only: bool = False) -> str:
    """Return a text with names instead of ids, said once; an id that the server does not know stays.

    ``versions_only``: where a name would not do, as of two campaigns called alike.
    """
    for key in dict.fromkeys(ID.findall(text)):
        if versions_only and not key.startswith("ver_"):
            continue
        word = _names.get(key) or _ask(key)
        if not key.startswith("ver_"):
            plain = "".join(shlex.split(word))
            for twice in (f"{key} {plain!r}", f"{key} ({plain!r})", f"{key} ({plain})"):
                text = text.replace(twice, key)
            text = text.replace(f"called {plain!r} already, {key}", f"called {plain!r} already")
        text = text.replace(key, word)
    return text


def remember_names(document: Any) -> None:
    """Learn the names in a document of the server, so that nobody asks for them; what a version cites may be renamed."""
    for one in document.values() if isinstance(document, Mapping) else document:
        if isinstance(one, Mapping | list | tuple):
            remember_names(one)
    if isinstance(document, Mapping) and ID.fullmatch(str(document.get("id"))) and {"name", "robot"} <= document.keys():
        _names[document["id"]] = _word(document["id"], document)


def begin_command() -> None:
    """Ask the server again, though it did not answer the command before."""
    _unasked[:] = [True]


def _word(key: str, found: Mapping[str, Any]) -> str:
    if found.get("number"):
        return f"{found['robot']} v{found['number']}"
    return shlex.quote(found["name"]) if found["name"] else key[:SHORT]


def _ask(key: str) -> str:
    """Ask the server, once for each id; where it does not answer at once, no more in this command."""
    if _unasked:
        try:
            with Kilter() as kilter:
                _names[key] = _word(key, kilter.run(_resolve_once(key)))
        except NotFoundError:
            _names[key] = key
        except (KilterError, ValueError):
            _unasked.clear()
    return _names.get(key, key)


def _resolve_once(key: str) -> Steps[Any]:
    """Ask without patience: neither a busy server nor a lost one is asked again."""
    answer = yield Request("GET", "/v1/resolve", {"kind": KINDS[key[:3]], "reference": key}, timeout_s=ANSWER_S)
    refuse(answer.status, answer.content)
    return json.loads(answer.content)


GAP, NARROWEST = 3, 8
LINES_OF_LIST = 23  # of a table on one screen


def table(
    head: Sequence[str], rows: Sequence[Sequence[str]], screen: int, title: str = "", numbers: bool = False
) -> str:
    """Return a table; ``numbers`` sets all columns but the first to the right."""
    widths = _fitting([max(map(len, column)) for column in zip(head, *rows, strict=True)], screen)
    rule = "─" * (sum(widths) + GAP * (len(widths) - 1))
    lines = [*_lines(head, widths, numbers), rule]
    for row in rows:
        lines += _lines(row, widths, numbers)
    return "\n".join(["", *([title] if title else []), *(f" {line}" for line in lines), ""])


def _fitting(widths: list[int], screen: int) -> list[int]:
    """Make the widest columns narrower until all fit."""
    room = max(screen - 2 - GAP * (len(widths) - 1), NARROWEST * len(widths))
    while sum(widths) > room:
        widest = max(range(len(widths)), key=widths.__getitem__)
        if widths[widest] <= NARROWEST:
            break
        widths[widest] -= 1
    return widths


def _lines(cells: Sequence[str], widths: Sequence[int], numbers: bool) -> Iterator[str]:
    folded = [_wrap_cell(cell, width) for cell, width in zip(cells, widths, strict=True)]
    for parts in zip_longest(*folded, fillvalue=""):
        set_ = [
            part.rjust(width) if numbers and k else part.ljust(width)
            for k, (part, width) in enumerate(zip(parts, widths, strict=True))
        ]
        yield (" " * GAP).join(set_).rstrip()


def _wrap_cell(cell: str, width: int) -> list[str]:
    return textwrap.wrap(cell, width) or [""] if len(cell) > width else [cell]


WIDE = 120  # columns of a screen, where no terminal is narrower


def screen_columns() -> int:
    """Columns of the terminal, at most those of a screen."""
    return min(shutil.get_terminal_size().columns, WIDE) if sys.stdout.isatty() else WIDE


def wrap_line(line: str, columns: int) -> list[str]:
    """Return a line as lines of at most so many columns, indented as it is; a text of several lines stays as it is."""
    if len(line) <= columns or "\n" in line:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.wrap(
        line.strip(), columns, initial_indent=indent, subsequent_indent=f"{indent}  ", break_on_hyphens=False
    )


def show_rows(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "", numbers: bool = False) -> None:
    """Print a table on stdout; ``numbers`` sets all columns but the first to the right."""
    named = [[name_ids(cell) for cell in row] for row in rows]
    print(table(head, named, screen_columns(), title, numbers))


def show_list(head: Sequence[str], rows: Sequence[Sequence[str]], newest_last: bool = False) -> None:
    """Print the rows of a list that fit a screen, and how many more there are."""
    named, screen = [[name_ids(cell) for cell in row] for row in rows], screen_columns()
    for count in range(min(len(named), LINES_OF_LIST), -1, -1):
        text = table(head, named[len(named) - count :] if newest_last else named[:count], screen)
        if text.count("\n") < LINES_OF_LIST or count == 1:
            break
    print(text)
    if left := len(named) - count:
        print(f"and {left} {'older' if newest_last else 'more'} (--json)")


def number(value: Any, digits: int = 4) -> str:
    """Write a number shortly, nothing for None."""
    if value is None:
        return ""
    if not isinstance(value, int | float):
        return str(value)
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e9 else text


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


SESSION_S = 12 * 3600.0


def is_note_due(server: str, sentence: str) -> bool:
    """Return whether a note of a server was not shown in the last twelve hours, and remember that it is shown now.

    Another cause or another robot is another sentence. Where nothing can be remembered, a note is always due.
    """
    file, now = _file(), time.time()
    key = hashlib.sha256(f"{server} {sentence}".encode()).hexdigest()[:16]
    try:
        shown = {str(name): float(at) for name, at in json.loads(file.read_text()).items()}
    except (OSError, ValueError, TypeError, AttributeError):
        shown = {}
    recent = {name: at for name, at in shown.items() if 0.0 <= now - at < SESSION_S}
    if key in recent:
        return False
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(recent | {key: now}))
    except OSError:
        pass
    return True


def _file() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "kilter" / "notes-shown.json"
