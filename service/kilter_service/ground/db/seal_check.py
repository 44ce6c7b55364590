"""Whether the rows are what Kilter stored: compared with their seals, table by table."""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import Connection, select

from kilter_service.ground.db import seals
from kilter_service.ground.db.sealed import AUDIT, SEALS, TOTALS, said_of_key, stored
from kilter_service.ground.db.seals import MODULUS, TABLES, Sealer
from kilter_service.ground.db.tables import AuditRow

MOST_NAMED = 50  # rows of a table
LARGE = frozenset({"jobs", "answered", "chunks"})  # what a quick check leaves out


def tables(*, quick: bool = False) -> list[str]:
    """Names of the sealed tables."""
    return [name for name in TABLES if not (quick and name in LARGE)]


def altered(connection: Connection, sealer: Sealer, name: str) -> Iterator[str]:
    """Sentences about the rows of a table that are not as they were stored."""
    total = connection.execute(select(TOTALS).where(TOTALS.c.thing == name)).mappings().first()
    if total is None:
        yield f"Table {name} has no seal: it was taken out past Kilter."
        return
    if total["keyed_by"] != sealer.number:
        yield f"Table {name} cannot be checked. {said_of_key(total['keyed_by'], sealer)}"
        return
    known = dict(connection.execute(select(SEALS.c.id, SEALS.c.digests).where(SEALS.c.thing == name)).all())
    named = list(_rows(connection, sealer, name, known))
    yield from named[:MOST_NAMED]
    if len(named) > MOST_NAMED:
        yield f"Table {name}: {len(named) - MOST_NAMED} more rows are altered, missing or new."
    weight = sum(sealer.weight(name, key, text) for key, text in known.items())
    if sealer.seal(name, total["rows"], total["total"], total["columns"]) != total["seal"]:
        yield f"Table {name}: the total over its rows was altered."
    elif total["rows"] != len(known):
        yield f"Table {name}: {total['rows']} rows were stored, and {len(known)} of them are sealed."
    elif f"{weight % MODULUS:064x}" != total["total"]:
        yield f"Table {name}: the seal of a row was altered, or put back to an earlier one."


def _rows(connection: Connection, sealer: Sealer, name: str, known: dict[str, str]) -> Iterator[str]:
    missing = set(known)
    for key, values in stored(connection, TABLES[name]):
        if key not in known:
            yield f"Table {name}, row {_shown(key)}: it was put in past Kilter."
            continue
        missing.discard(key)
        digests = seals.read(known[key])
        other = [c for c, value in values.items() if digests.get(c) != sealer.digest(name, key, c, value)]
        if other:
            yield f"Table {name}, row {_shown(key)}: {', '.join(other)} {'was' if len(other) == 1 else 'were'} altered."
    for key in sorted(missing):
        yield f"Table {name}, row {_shown(key)} is missing."


def _shown(key: str) -> str:
    return key.encode("utf-8", "backslashreplace").decode()[:100]


def audit_end(connection: Connection, sealer: Sealer) -> Iterator[str]:
    """Sentences about an audit that does not end where Kilter left it."""
    total = connection.execute(select(TOTALS).where(TOTALS.c.thing == AUDIT)).mappings().first()
    if total is None:
        yield "The end of the audit has no seal: it was taken out past Kilter."
    elif total["keyed_by"] != sealer.number:
        yield f"The end of the audit cannot be checked. {said_of_key(total['keyed_by'], sealer)}"
    elif sealer.seal(AUDIT, total["rows"], total["total"], total["columns"]) != total["seal"]:
        yield "The seal of the audit's end was altered."
    else:
        query = select(AuditRow.number, AuditRow.sha256).order_by(AuditRow.number.desc()).limit(1)
        last = connection.execute(query).first()
        number, sha256 = (0, "") if last is None else tuple(last)
        if (number, sha256) != (total["rows"], total["total"]):
            yield f"The audit ends at entry {number}, and {total['rows']} were written: its end was cut off or rewritten."
