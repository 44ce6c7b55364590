"""Seals of what is stored already: all rows, or the tables and columns that a migration brought.

Whether the rows are what Kilter stored: compared with their seals, table by table.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sqlalchemy import Connection, Table, Text, cast, delete, insert, literal, select
from sqlalchemy.types import JSON

from kilter_service.ground.db import seals
from kilter_service.ground.db.database_seal import (
    AUDIT,
    ONLY,
    WHOLE,
    DatabaseSeal,
    audit_end,
    describe_other_key,
    describe_unsealed,
    read_database_seal,
    refuse_other_key,
)
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.sealed import CHANGE, SEALS, STORE, hex_total, in_parts
from kilter_service.ground.db.seals import MODULUS, TABLES, Sealer
from kilter_service.ground.errors import ServiceError

AT_ONCE_READ = 50  # rows in memory
AUDIT_TABLE = Row.metadata.tables[AUDIT]


def complete(connection: Connection, sealer: Sealer) -> None:
    """Seal the tables and columns that a migration brought; what is sealed stays as it is.

    Raises:
        ServiceError: there are rows that no key ever sealed, and this process has one.

    """
    whole = read_database_seal(connection, sealer)
    if whole is None:
        if sealer.number and any(_has_rows(connection, table) for table in (*TABLES.values(), AUDIT_TABLE)):
            raise ServiceError(describe_unsealed(), code="seal_key_other")
        if not _has_rows(connection, SEALS):  # else it was taken out past Kilter, and that goes on being a finding
            anew(connection, sealer)
        return
    refuse_other_key(whole, sealer)
    for table in TABLES.values():
        _complete(connection, sealer, whole, table)
    whole.write(connection, sealer)


def _has_rows(connection: Connection, table: Table) -> bool:
    return connection.execute(select(literal(1)).select_from(table).limit(1)).first() is not None


def anew(connection: Connection, sealer: Sealer) -> None:
    """Seal all rows as they are now."""
    connection.execute(delete(SEALS))
    connection.execute(delete(WHOLE))
    whole = DatabaseSeal({AUDIT: audit_end(connection)}, sealer.number, fits=True)
    for table in TABLES.values():
        _complete(connection, sealer, whole, table)
    connection.execute(insert(WHOLE).values(id=ONLY, totals="", keyed_by=sealer.number, seal=""))
    whole.write(connection, sealer)


def _complete(connection: Connection, sealer: Sealer, whole: DatabaseSeal, table: Table) -> None:
    """Seal the rows of a new table, and the new columns of the rows of another one."""
    name, first = table.name, table.name not in whole.totals
    lacking = {} if first else _lacking(connection, table)
    (rows, weight), changes = whole.total(name), []
    for key, values in stored(connection, table) if first or lacking else ():
        if not first and key not in lacking:
            continue
        had = seals.read(lacking[key]) if lacking else {}
        more = {column: sealer.digest(name, key, column, one) for column, one in values.items() if column not in had}
        text = seals.written({**had, **more})
        changes.append({"thing": name, "id": key, "b_thing": name, "b_id": key, "digests": text})
        rows, weight = rows + first, weight + sealer.weight(name, key, text)
        weight -= sealer.weight(name, key, lacking[key]) if lacking else 0
    for some in in_parts(changes):
        connection.execute(STORE if first else CHANGE, some)
    whole.totals[name] = rows, hex_total(weight)


def _lacking(connection: Connection, table: Table) -> dict[str, str]:
    """Seals of rows that lack the digest of a column."""
    wanted = {column.name for column in seals.sealed_columns(table)}
    query = select(SEALS.c.id, SEALS.c.digests).where(SEALS.c.thing == table.name)
    return {key: text for key, text in connection.execute(query) if wanted - seals.read(text).keys()}


def stored(connection: Connection, table: Table) -> Iterator[tuple[str, dict[str, Any]]]:
    """Rows of a table as SQLite stores them, by their keys; nothing in them is decoded, however damaged."""
    columns = seals.sealed_columns(table)
    if connection.dialect.name == "sqlite":
        yield from _of_sqlite(connection, table)
        return
    shown = [cast(c, Text).label(c.name) if isinstance(c.type, JSON) else c for c in columns]
    with connection.execute(select(*shown).execution_options(yield_per=AT_ONCE_READ)) as rows:
        for row in rows.mappings():
            values = {c.name: row[c.name] if isinstance(c.type, JSON) else seals.raw(c, row[c.name]) for c in columns}
            yield seals.format_row_key(values[c.name] for c in table.primary_key.columns), values


def _of_sqlite(connection: Connection, table: Table) -> Iterator[tuple[str, dict[str, Any]]]:
    names = [column.name for column in seals.sealed_columns(table)]
    keys = [column.name for column in table.primary_key.columns]
    quoted = ", ".join(f'"{name}"' for name in names)
    driver: Any = connection.connection.driver_connection
    before = driver.text_factory
    cursor = driver.cursor()
    try:
        driver.text_factory = _text
        for row in cursor.execute(f'SELECT {quoted} FROM "{table.name}" NOT INDEXED'):  # noqa: S608 (names of our tables)
            values = dict(zip(names, row, strict=True))
            yield seals.format_row_key(values[key] for key in keys), values
    finally:
        cursor.close()
        driver.text_factory = before


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")


MOST_NAMED = 50  # rows of a table
LARGE = frozenset({"jobs", "answered", "chunks"})  # what a quick check leaves out


def tables(*, quick: bool = False) -> list[str]:
    """Names of the sealed tables."""
    return [name for name in TABLES if not (quick and name in LARGE)]


def other_key(connection: Connection, sealer: Sealer) -> str:
    """Say that what is stored is not sealed with the key in use, so that no seal can be compared; empty: it is."""
    whole = read_database_seal(connection, sealer)
    keyed_by = "" if whole is None else whole.keyed_by
    return "" if keyed_by == sealer.number else describe_other_key(keyed_by, sealer)


def describe_altered_rows(connection: Connection, sealer: Sealer, name: str) -> Iterator[str]:
    """Sentences about the rows of a table that are not as they were stored."""
    whole = read_database_seal(connection, sealer)
    known = dict(connection.execute(select(SEALS.c.id, SEALS.c.digests).where(SEALS.c.thing == name)).all())
    named = list(_rows(connection, sealer, name, known))
    yield from named[:MOST_NAMED]
    if len(named) > MOST_NAMED:
        yield f"Table {name}: {len(named) - MOST_NAMED} more rows are altered, missing or new."
    if whole is None:
        return
    rows, total = whole.total(name)
    if rows != len(known):
        yield f"Table {name}: {rows} rows were stored, and {len(known)} of them are sealed."
    elif total != sum(sealer.weight(name, key, text) for key, text in known.items()) % MODULUS:
        yield f"Table {name}: the seal of a row was altered, or put back to an earlier one."


def _rows(connection: Connection, sealer: Sealer, name: str, known: dict[str, str]) -> Iterator[str]:
    missing = set(known)
    for key, values in stored(connection, TABLES[name]):
        if key not in known:
            yield f"Table {name}, row {_printable_key(key)}: it was put in past Kilter."
            continue
        missing.discard(key)
        digests = seals.read(known[key])
        other = [c for c, value in values.items() if digests.get(c) != sealer.digest(name, key, c, value)]
        if other:
            yield f"Table {name}, row {_printable_key(key)}: {', '.join(other)} {'was' if len(other) == 1 else 'were'} altered."
    for key in sorted(missing):
        yield f"Table {name}, row {_printable_key(key)} is missing."


def _printable_key(key: str) -> str:
    return key.encode("utf-8", "backslashreplace").decode()[:100]


def whole_altered(connection: Connection, sealer: Sealer) -> Iterator[str]:
    """Sentences about a seal over all tables that does not fit, and an audit that does not end where Kilter left it."""
    whole = read_database_seal(connection, sealer)
    if whole is None:
        yield "The seal over all tables is missing: it was taken out past Kilter."
        return
    if not whole.fits:
        yield "The seal over all tables does not fit: a table was put back to an earlier state, or a total was altered."
    for name in connection.execute(select(SEALS.c.thing).where(SEALS.c.thing.not_in(TABLES)).distinct()).scalars():
        yield f"Table seals, rows of {_printable_key(name)}: they were put in past Kilter, there is no such table."
    for key in connection.execute(select(WHOLE.c.id).where(WHOLE.c.id != ONLY)).scalars():
        yield f"Table {WHOLE.name}, row {key}: it was put in past Kilter."
    end = audit_end(connection)
    if end != whole.totals.get(AUDIT):
        written = whole.total(AUDIT)[0]
        yield f"The audit ends at entry {end[0]}, and {written} were written: its end was cut off or rewritten."
