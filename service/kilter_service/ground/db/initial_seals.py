"""Seals of what is stored already: all rows, or the tables and columns that a migration brought."""

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
    describe_unsealed,
    read_database_seal,
    refuse_other_key,
)
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.sealed import CHANGE, SEALS, STORE, hex_total, in_parts
from kilter_service.ground.db.seals import TABLES, Sealer
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
