"""Rows are sealed in the transaction that stores them: taken from the session, so that no feature has to remember it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

from sqlalchemy import Connection, Table, Text, cast, delete, event, insert, inspect, select, update
from sqlalchemy.orm import ORMExecuteState, Session, sessionmaker
from sqlalchemy.types import JSON

from kilter_service.ground.db import seals
from kilter_service.ground.db.audited import TOLD
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.seals import MODULUS, TABLES, Digests, Sealer
from kilter_service.ground.db.tables import AuditRow, SealedTableRow, SealRow
from kilter_service.ground.errors import ServiceError

PENDING = "kilter_seals"
AT_ONCE = 500  # keys in a query
AT_ONCE_READ = 50  # rows in memory
AUDIT = AuditRow.__tablename__
SEALS, TOTALS = (Row.metadata.tables[one.__tablename__] for one in (SealRow, SealedTableRow))
Place = tuple[str, str]  # table and key of a row
Key = TypeVar("Key")


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
        """Write the seals and totals."""
        by_table: dict[str, list[Place]] = {}
        for place in (*self.stored, *self.changed, *self.gone):
            by_table.setdefault(place[0], []).append(place)
        for table, places in by_table.items():
            self._table(connection, table, {key for _, key in places})
        if audited is not None:
            write_total(connection, self._sealer, AUDIT, *audited)

    def _table(self, connection: Connection, table: str, keys: set[str]) -> None:
        total = total_of(connection, self._sealer, table)
        if total is None:
            return
        rows, weight, columns = total
        known = _known(connection, table, sorted(keys))
        new, other, gone = [], [], []
        for key in sorted(keys):
            place, had = (table, key), known.get(key)
            text = self._text(place, had)
            if had is not None and place in self.gone:
                gone.append(key)
                rows, weight, had = rows - 1, weight - self._sealer.weight(table, key, had), None
            if text is None or text == had:
                continue
            if had is None:
                rows += 1
                new.append({"thing": table, "id": key, "digests": text})
            else:
                weight -= self._sealer.weight(table, key, had)
                other.append((key, text))
            weight += self._sealer.weight(table, key, text)
        for some in _parts(gone):
            connection.execute(delete(SEALS).where(SEALS.c.thing == table, SEALS.c.id.in_(some)))
        if new:
            connection.execute(insert(SEALS), new)
        for key, text in other:
            _reseal(connection, table, key, text)
        write_total(connection, self._sealer, table, rows, _hex(weight), columns)

    def _text(self, place: Place, had: str | None) -> str | None:
        """New digests of a row; None: none, or its seal stays as it is."""
        if place in self.stored:
            # A key that has a seal: a row was taken out past Kilter, and its seal goes on saying so.
            return seals.written(self.stored[place]) if had is None or place in self.gone else had
        if place in self.changed and had is not None:
            return seals.written({**seals.read(had), **self.changed[place]})
        return None


def _parts(keys: Sequence[Key]) -> Iterator[Sequence[Key]]:
    for start in range(0, len(keys), AT_ONCE):
        yield keys[start : start + AT_ONCE]


def _hex(weight: int) -> str:
    return f"{weight % MODULUS:064x}"


def _known(connection: Connection, table: str, keys: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for some in _parts(keys):
        query = select(SEALS.c.id, SEALS.c.digests).where(SEALS.c.thing == table, SEALS.c.id.in_(some))
        found.update(connection.execute(query).all())
    return found


def total_of(connection: Connection, sealer: Sealer, table: str) -> tuple[int, int, str] | None:
    """Return number of rows, their total and the sealed columns of a table; None where it is not sealed.

    Raises:
        ServiceError: it is sealed with another key than that of this process.

    """
    row = connection.execute(select(TOTALS).where(TOTALS.c.thing == table)).mappings().first()
    if row is None:
        return None
    if row["keyed_by"] != sealer.number:
        raise ServiceError(said_of_key(row["keyed_by"], sealer), code="seal_key_other")
    try:
        return int(row["rows"]), int(row["total"], 16), row["columns"]
    except ValueError:
        return int(row["rows"]), 0, row["columns"]  # altered, and its seal says so: what follows does not fit either


def said_of_key(keyed_by: str, sealer: Sealer) -> str:
    """Say that the rows are sealed with another key than that of this process, and what helps."""
    if not keyed_by:
        return f"The rows are sealed without the key that {seals.KEY_VARIABLE} names: run `kilterd seal` once."
    now = "with another one" if sealer.number else "without one"
    return (
        f"The rows are sealed with the key {keyed_by}, and this process runs {now}: set {seals.KEY_VARIABLE} to its file, or "
        "run `kilterd seal --accept` once, if it is lost."
    )


def write_total(
    connection: Connection, sealer: Sealer, table: str, rows: int, total: str, columns: str = "", *, new: bool = False
) -> None:
    """Write how many rows a table has, their total, and the seal over both."""
    values = {
        "rows": rows, "total": total, "columns": columns, "keyed_by": sealer.number,
        "seal": sealer.seal(table, rows, total, columns),
    }  # fmt: skip
    if new:
        connection.execute(insert(TOTALS).values(thing=table, **values))
        return
    connection.execute(update(TOTALS).where(TOTALS.c.thing == table).values(**values))


def listen(sessions: sessionmaker[Session], sealer: Sealer) -> None:
    """Seal what the sessions of a maker change; after the audit, whose end is sealed too."""

    def pending(session: Session) -> Pending:
        found: Pending = session.info.setdefault(PENDING, Pending(sealer))
        return found

    def flushing(session: Session, _context: Any, _instances: Any) -> None:
        for row in session.deleted:
            _cascade(session.connection(), pending(session), row.__table__, [_key(row)])

    def flushed(session: Session, _context: Any) -> None:
        for row in (one for one in session.new if one.__tablename__ in TABLES):
            columns = seals.columns_of(TABLES[row.__tablename__])
            pending(session).store(_place(row), _digests(sealer, row, {column.name for column in columns}))
        for row in (one for one in session.deleted if one.__tablename__ in TABLES):
            pending(session).remove(_place(row))
        for row in (one for one in session.dirty if one.__tablename__ in TABLES):
            names = {one.key for one in inspect(row).attrs if one.history.has_changes()}
            digests = _digests(sealer, row, names)
            if digests:
                pending(session).change(_place(row), digests)

    def executed(state: ORMExecuteState) -> None:
        if state.is_delete or state.is_update:
            _by_statement(state, pending(state.session))

    def committing(session: Session) -> None:
        # The audit has flushed, and has its entry.
        changed, told = session.info.pop(PENDING, None), session.info.get(TOLD)
        if changed is not None or told is not None:
            (changed or Pending(sealer)).apply(session.connection(), told)

    event.listen(sessions, "before_flush", flushing)
    event.listen(sessions, "after_flush", flushed)
    event.listen(sessions, "do_orm_execute", executed)
    event.listen(sessions, "before_commit", committing)


def _key(row: Row) -> tuple[Any, ...]:
    return tuple(inspect(type(row)).primary_key_from_instance(row))


def _place(row: Row) -> Place:
    table = Row.metadata.tables[row.__tablename__]
    return row.__tablename__, _id(table, _key(row))


def _id(table: Table, key: Sequence[Any]) -> str:
    return seals.id_of(seals.raw(c, v) for c, v in zip(table.primary_key.columns, key, strict=True))


def _digests(sealer: Sealer, row: Row, names: Iterable[str]) -> Digests:
    table, key = _place(row)
    columns = {column.name: column for column in seals.columns_of(TABLES[table])}
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
                for some in _parts(keys):
                    query = select(*child.primary_key.columns).where(reference.parent.in_([key[0] for key in some]))
                    _gone(connection, pending, child, [tuple(found) for found in connection.execute(query)])


def complete(connection: Connection, sealer: Sealer) -> None:
    """Seal the tables and columns that a migration brought; what is sealed stays as it is."""
    for name, table in TABLES.items():
        total = total_of(connection, sealer, name)
        wanted = [column.name for column in seals.columns_of(table)]
        known = set() if total is None else set(total[2].split(" "))
        if set(wanted) - known:
            _complete(connection, sealer, table, known, first=total is None)
    if total_of(connection, sealer, AUDIT) is None:
        query = select(AuditRow.number, AuditRow.sha256).order_by(AuditRow.number.desc()).limit(1)
        last = connection.execute(query).first()
        number, sha256 = (0, "") if last is None else (last.number, last.sha256)
        write_total(connection, sealer, AUDIT, number, sha256, new=True)


def check_key(database_reading: Session, sealer: Sealer) -> None:
    """Refuse to work on rows that are sealed with another key, before anything is done.

    Raises:
        ServiceError: they are.

    """
    total_of(database_reading.connection(), sealer, AUDIT)


def keyed_by(connection: Connection) -> str:
    """Return the number of the key that the rows are sealed with; empty: with none."""
    return connection.execute(select(TOTALS.c.keyed_by).where(TOTALS.c.thing == AUDIT)).scalar() or ""


def anew(connection: Connection, sealer: Sealer) -> None:
    """Seal all rows as they are now."""
    connection.execute(delete(SEALS))
    connection.execute(delete(TOTALS))
    complete(connection, sealer)


def _complete(connection: Connection, sealer: Sealer, table: Table, known: set[str], *, first: bool) -> None:
    found = [
        (
            key,
            {name: sealer.digest(table.name, key, name, value) for name, value in values.items() if name not in known},
        )
        for key, values in stored(connection, table)
    ]
    if first:
        rows = [{"thing": table.name, "id": key, "digests": seals.written(digests)} for key, digests in found]
        for some in _parts(rows):
            connection.execute(insert(SEALS), some)
    else:
        for key, digests in found:
            had = _known(connection, table.name, [key]).get(key)
            if had is not None:  # else a row that was put in past Kilter
                _reseal(connection, table.name, key, seals.written({**seals.read(had), **digests}))
    number, weight = 0, 0
    for key, text in connection.execute(select(SEALS.c.id, SEALS.c.digests).where(SEALS.c.thing == table.name)):
        number, weight = number + 1, weight + sealer.weight(table.name, key, text)
    names = " ".join(column.name for column in seals.columns_of(table))
    write_total(connection, sealer, table.name, number, _hex(weight), names, new=first)


def _reseal(connection: Connection, table: str, key: str, text: str) -> None:
    connection.execute(update(SEALS).where(SEALS.c.thing == table, SEALS.c.id == key).values(digests=text))


def stored(connection: Connection, table: Table) -> Iterator[tuple[str, dict[str, Any]]]:
    """Rows of a table as SQLite stores them, by their keys; nothing in them is decoded, however damaged."""
    columns = seals.columns_of(table)
    if connection.dialect.name == "sqlite":
        yield from _of_sqlite(connection, table)
        return
    shown = [cast(c, Text).label(c.name) if isinstance(c.type, JSON) else c for c in columns]
    for row in connection.execute(select(*shown).execution_options(yield_per=AT_ONCE_READ)).mappings():
        values = {c.name: row[c.name] if isinstance(c.type, JSON) else seals.raw(c, row[c.name]) for c in columns}
        yield seals.id_of(values[c.name] for c in table.primary_key.columns), values


def _of_sqlite(connection: Connection, table: Table) -> Iterator[tuple[str, dict[str, Any]]]:
    names = [column.name for column in seals.columns_of(table)]
    keys = [column.name for column in table.primary_key.columns]
    quoted = ", ".join(f'"{name}"' for name in names)
    driver: Any = connection.connection.driver_connection
    before = driver.text_factory
    cursor = driver.cursor()
    try:
        driver.text_factory = _text
        for row in cursor.execute(f'SELECT {quoted} FROM "{table.name}" NOT INDEXED'):  # noqa: S608 (names of our tables)
            values = dict(zip(names, row, strict=True))
            yield seals.id_of(values[key] for key in keys), values
    finally:
        cursor.close()
        driver.text_factory = before


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")
