"""The clock of the job engine where Python is linked to an old SQLite.

DBOS takes its time stamps from ``unixepoch('subsec')`` when Python is 3.12 or newer. That function came with SQLite 3.42, and
which SQLite Python has is another matter: an older one answers NULL, and the worker dies at its start. A jobs database
that was made with a newer SQLite holds the word in the defaults of its tables, so Python 3.11 meets it too.
"""

from __future__ import annotations

import sqlite3
import time
from typing import Any

KNOWS_SUBSEC = (3, 42)


class _Connection(sqlite3.Connection):
    """A connection on which ``unixepoch('subsec')`` is known."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        # SQLite looks among a connection's own functions before its built-in ones; this is the one with one argument.
        self.create_function("unixepoch", 1, _seconds)


def keep_time() -> None:
    """Teach the connections that DBOS opens in this process ``unixepoch('subsec')`` if their SQLite does not know it."""
    from dbos._sys_db_sqlite import SQLiteSystemDatabase

    create = SQLiteSystemDatabase._create_engine
    if sqlite3.sqlite_version_info >= KNOWS_SUBSEC or hasattr(create, "__wrapped__"):
        return

    # The worker could hand its arguments over by configuration, the client of the API process has no option for them.
    def with_clock(self: SQLiteSystemDatabase, url: str, options: dict[str, Any]) -> Any:
        arguments = {**(options.get("connect_args") or {}), "factory": _Connection}
        return create(self, url, {**options, "connect_args": arguments})

    with_clock.__wrapped__ = create  # type: ignore[attr-defined]
    SQLiteSystemDatabase._create_engine = with_clock  # type: ignore[assignment, method-assign]


def _seconds(asked: Any) -> float:
    """Answer as SQLite 3.42 does: seconds since 1970 with three decimals."""
    if asked != "subsec":
        raise ValueError(f"unixepoch({asked!r}) is not known to Kilter's clock for the job engine")
    return round(time.time(), 3)
