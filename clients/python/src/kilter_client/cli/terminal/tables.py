"""Plain tables for people."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from typing import Any

from kilter_client.cli.terminal.plain_table import table

WIDE = 200  # columns when nobody's terminal says otherwise


def show_rows(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "", numbers: bool = False) -> None:
    """Print a table on stdout; ``numbers`` sets all columns but the first to the right."""
    screen = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDE
    print(table(head, rows, screen, title, numbers))


def number(value: Any, digits: int = 4) -> str:
    """Write a number shortly, nothing for None."""
    if value is None:
        return ""
    return f"{value:.{digits}g}" if isinstance(value, int | float) else str(value)
