"""Rows are sealed in the transaction that stores them: taken from the session, so that no feature has to remember it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

from sqlalchemy import Connection, Table, bindparam, delete, event, insert, inspect, select, update
from sqlalchemy.orm import ORMExecuteState, Session, sessionmaker

from kilter_service.ground.db import seals
from kilter_service.ground.db.audited import TOLD
from kilter_service.ground.db.database_seal import AUDIT, read_database_seal, refuse_other_key
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.seals import MODULUS, TABLES, Digests, Sealer, SealRow

log = logging.getLogger("kilter.seals")

PENDING = "kilter_seals"
AT_ONCE = 500  # keys in a query
SEALS = Row.metadata.tables[SealRow.__tablename__]
Place = tuple[str, str]  # table and key of a row
Key = TypeVar("Key")
# Made once: to build a statement takes longer than to execute it.
_OF_KEYS = (SEALS.c.thing == bindparam("b_thing"), SEALS.c.id.in_(bindparam("b_ids", expanding=True)))
_KNOWN = select(SEALS.c.id, SEALS.c.digests).where(*_OF_KEYS)
_REMOVE = delete(SEALS).where(*_OF_KEYS)
STORE = insert(SEALS)
CHANGE = update(SEALS).where(SEALS.c.thing == bindparam("b_thing"), SEALS.c.id == bindparam("b_id"))
CHANGE = CHANGE.values(digests=bindparam("digests"))


class Pending:
    """What a transaction changes of the seals."""

    def __init__(self, sealer: Sealer) -> None:
        self._sealer = sealer
        self.stored: dict[Place, Digests] = {}
        self.changed: dict[Place, Digests] = {}
        self.gone: set[Place] = set()

    def store(self, place: Place, digests: Digests) -> None:
        """Note a new row."""
        self.stored[place] = digests

    def change(self, place: Place, digests: Digests) -> None:
        """Note columns of a row."""
        (self.stored if place in self.stored else self.changed).setdefault(place, {}).update(digests)

    def remove(self, place: Place) -> None:
        """Note that a row is no more. One that is stored anew under its key has other digests."""
        self.changed.pop(place, None)
        if self.stored.pop(place, None) is None:
            self.gone.add(place)

    def apply(self, connection: Connection, audited: tuple[int, str] | None) -> None:
        """Write the seals of the rows, the totals, and the seal over all of them.

        Raises:
            ServiceError: they are sealed with another key than that of this process.

        """
        whole = read_database_seal(connection, self._sealer)
        refuse_other_key(whole, self._sealer)
        by_table: dict[str, set[str]] = {}
        for table, key in (*self.stored, *self.changed, *self.gone):
            by_table.setdefault(table, set()).add(key)
        changes = {table: self._rows(connection, table, keys) for table, keys in by_table.items()}
        if whole is None:
            return
        for table, (more, heavier) in changes.items():
            rows, weight = whole.total(table)
            whole.totals[table] = rows + more, hex_total(weight + heavier)
        if audited is not None:
            whole.totals[AUDIT] = audited
        if not whole.fits:
            log.error("stored data were altered past Kilter: run `kilterd verify`")
        whole.write(connection, self._sealer)

    def _rows(self, connection: Connection, table: str, keys: set[str]) -> tuple[int, int]:
        """Write the seals of rows; returns by how much the number of rows and their total grow."""
        more, heavier = 0, 0
        known = _stored_digests(connection, table, sorted(keys))
        new, other, gone = [], [], []
        for key in sorted(keys):
            place, had = (table, key), known.get(key)
            text = self._text(place, had)
            if had is not None and place in self.gone:
                gone.append(key)
                more, heavier, had = more - 1, heavier - self._sealer.weight(table, key, had), None
            if text is None or text == had:
                continue
            if had is None:
                more += 1
                new.append({"thing": table, "id": key, "digests": text})
            else:
                heavier -= self._sealer.weight(table, key, had)
                other.append({"b_thing": table, "b_id": key, "digests": text})
            heavier += self._sealer.weight(table, key, text)
        for some in in_parts(gone):
            connection.execute(_REMOVE, {"b_thing": table, "b_ids": some})
        if new:
            connection.execute(STORE, new)
        if other:
            connection.execute(CHANGE, other)
        return more, heavier

    def _text(self, place: Place, had: str | None) -> str | None:
        """New digests of a row; None: none, or its seal stays as it is."""
        if place in self.stored:
            # A key that has a seal: a row was taken out past Kilter, and its seal goes on saying so.
            return seals.written(self.stored[place]) if had is None or place in self.gone else had
        if place in self.changed and had is not None:
            return seals.written({**seals.read(had), **self.changed[place]})
        return None


def in_parts(keys: Sequence[Key], at_once: int = AT_ONCE) -> Iterator[Sequence[Key]]:
    """Yield as many at once as a statement takes."""
    for start in range(0, len(keys), at_once):
        yield keys[start : start + at_once]


def hex_total(weight: int) -> str:
    """Return a total as it is stored."""
    return f"{weight % MODULUS:064x}"


def _stored_digests(connection: Connection, table: str, keys: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for some in in_parts(keys):
        found.update(connection.execute(_KNOWN, {"b_thing": table, "b_ids": some}).all())
    return found


def listen(sessions: sessionmaker[Session], sealer: Sealer) -> None:
    """Seal what the sessions of a maker change; after the audit, whose end is sealed too."""

    def pending(session: Session) -> Pending:
        found: Pending = session.info.setdefault(PENDING, Pending(sealer))
        return found

    def flushing(session: Session, _context: Any, _instances: Any) -> None:
        for row in session.deleted:
            _cascade(session.connection(), pending(session), row.__table__, [_key(row)])

    def seal_flushed_rows(session: Session, _context: Any) -> None:
        for row in (one for one in session.new if one.__tablename__ in TABLES):
            columns = seals.sealed_columns(TABLES[row.__tablename__])
            pending(session).store(_place(row), _digests(sealer, row, {column.name for column in columns}))
        for row in (one for one in session.deleted if one.__tablename__ in TABLES):
            pending(session).remove(_place(row))
        for row in (one for one in session.dirty if one.__tablename__ in TABLES):
            names = {one.key for one in inspect(row).attrs if one.history.has_changes()}
            digests = _digests(sealer, row, names)
            if digests:
                pending(session).change(_place(row), digests)

    def seal_bulk_statement(state: ORMExecuteState) -> None:
        if state.is_delete or state.is_update:
            _by_statement(state, pending(state.session))

    def committing(session: Session) -> None:
        # The audit has flushed, and has its entry.
        changed, told = session.info.pop(PENDING, None), session.info.get(TOLD)
        if changed is not None or told is not None:
            (changed or Pending(sealer)).apply(session.connection(), told)

    event.listen(sessions, "before_flush", flushing)
    event.listen(sessions, "after_flush", seal_flushed_rows)
    event.listen(sessions, "do_orm_execute", seal_bulk_statement)
    event.listen(sessions, "before_commit", committing)


def _key(row: Row) -> tuple[Any, ...]:
    return tuple(inspect(type(row)).primary_key_from_instance(row))


def _place(row: Row) -> Place:
    table = Row.metadata.tables[row.__tablename__]
    return row.__tablename__, _id(table, _key(row))


def _id(table: Table, key: Sequence[Any]) -> str:
    return seals.format_row_key(seals.raw(c, v) for c, v in zip(table.primary_key.columns, key, strict=True))


def _digests(sealer: Sealer, row: Row, names: Iterable[str]) -> Digests:
    table, key = _place(row)
    columns = {column.name: column for column in seals.sealed_columns(TABLES[table])}
    return {
        name: sealer.digest(table, key, name, seals.raw(columns[name], getattr(row, name)))
        for name in names
        if name in columns
    }


def _by_statement(state: ORMExecuteState, pending: Pending) -> None:
    """Rows that one statement deletes, and those that the database deletes with them."""
    statement: Any = state.statement
    table: Table = statement.table
    if table.name not in TABLES:
        return
    if state.is_update:
        raise RuntimeError(f"Change rows of {table.name} as objects: a statement of many leaves their seals behind.")
    query = select(*table.primary_key.columns)
    if statement.whereclause is not None:
        query = query.where(statement.whereclause)
    connection = state.session.connection()
    keys = [tuple(found) for found in connection.execute(query, state.parameters or {})]
    _gone(connection, pending, table, keys)


def _gone(connection: Connection, pending: Pending, table: Table, keys: Sequence[tuple[Any, ...]]) -> None:
    _cascade(connection, pending, table, keys)
    for key in keys:
        pending.remove((table.name, _id(table, key)))


def _cascade(connection: Connection, pending: Pending, table: Any, keys: Sequence[tuple[Any, ...]]) -> None:
    """Rows of other tables that the database deletes with these."""
    for child in TABLES.values():
        for reference in child.foreign_keys:
            if reference.ondelete == "CASCADE" and reference.column.table.name == table.name:
                for some in in_parts(keys):
                    query = select(*child.primary_key.columns).where(reference.parent.in_([key[0] for key in some]))
                    _gone(connection, pending, child, [tuple(found) for found in connection.execute(query)])
