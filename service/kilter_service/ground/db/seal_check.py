"""Whether the rows are what Kilter stored: compared with their seals, table by table."""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import Connection, select

from kilter_service.ground.db import seals
from kilter_service.ground.db.database_seal import AUDIT, ONLY, WHOLE, audit_end, describe_other_key, read_database_seal
from kilter_service.ground.db.initial_seals import stored
from kilter_service.ground.db.sealed import SEALS
from kilter_service.ground.db.seals import MODULUS, TABLES, Sealer

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
