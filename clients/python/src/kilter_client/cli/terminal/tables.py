"""Plain tables for people."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import Any

from kilter_client.cli.terminal.name_words import name_ids

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
