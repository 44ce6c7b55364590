"""Plain tables for people."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

WIDE = 200  # columns when nobody's terminal says otherwise


def show_rows(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "", numbers: bool = False) -> None:
    """Print a table on stdout; ``numbers`` sets all columns but the first to the right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, title=title or None, title_justify="left", pad_edge=False)
    for index, name in enumerate(head):
        table.add_column(name, justify="right" if numbers and index else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else WIDE, markup=False, highlight=False).print(table)


def number(value: Any, digits: int = 4) -> str:
    """Write a number shortly, nothing for None."""
    if value is None:
        return ""
    return f"{value:.{digits}g}" if isinstance(value, int | float) else str(value)
