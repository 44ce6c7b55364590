"""Queries that are asked several times a second: written as SQL once, and on a connection that is kept."""

from __future__ import annotations

import contextlib
import weakref
from typing import Any

from sqlalchemy import Select

from kilter_service.ground.db.database import Database


class Lookout:
    """Asks whether there is anything to do, for a thirtieth of the time of a session; for one thread."""

    def __init__(self, database: Database, *queries: Select[Any]) -> None:
        self._database, self._queries = database, queries
        dialect = database.engine.dialect
        compiled = [query.compile(dialect=dialect, compile_kwargs={"render_postcompile": True}) for query in queries]
        self._statements = [
            (one.string, one.params if one.positiontup is None else tuple(one.params[name] for name in one.positiontup))
            for one in compiled
        ]
        self._connection: Any = None

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows of the queries, one after the other; what is wrong with the database is raised as by a session."""
        try:
            cursor = self._connected().cursor()
            return [tuple(row) for statement in self._statements for row in cursor.execute(*statement).fetchall()]
        except Exception:
            self.close()
            with self._database.reading() as session:
                return [tuple(row) for query in self._queries for row in session.execute(query)]

    def _connected(self) -> Any:
        if self._connection is None:
            pooled = self._database.engine.raw_connection()
            self._connection = found = pooled.dbapi_connection
            # Out of the pool, which hands out none that commits by itself, and would log the roll-back of one that is lost.
            pooled.detach()
            self._closing = weakref.finalize(self, found.close)  # type: ignore[union-attr]
            if self._database.engine.dialect.name != "sqlite":
                self._connection.autocommit = True
        return self._connection

    def close(self) -> None:
        """Close the connection; the next question opens another."""
        if self._connection is not None:
            self._connection = None
            with contextlib.suppress(Exception):  # of a connection that is lost
                self._closing()
