"""Whether tokens, activations and repairs are what the audit says of them: rights, and what arms are sent, rest on these.

The audit has who stored, changed or removed each of them, in a chain of its own. So a row that was put back to an earlier
state is found, whoever computed its seals anew. What is older than the audit is not in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Table, select
from sqlalchemy.orm import Session

from kilter_service.ground.db.audited import hash_when_long
from kilter_service.ground.db.row import Instant, Row
from kilter_service.ground.db.tables import ActivationRow, AuditRow, RepairRow, RobotRow, TokenRow

AT_ONCE = 500  # entries in memory
COMPARED = (TokenRow, ActivationRow, RepairRow)
Audited = dict[str, dict[str, Any]]  # by table and key, as the audit writes them: the last value of each column


class Difference(NamedTuple):
    """A row that is not what the audit says of it: both, as the audit writes them, and a sentence."""

    thing: str
    audited: dict[str, Any] | None
    stored: dict[str, Any] | None
    sentence: str


def audit_differences(session: Session) -> Iterator[Difference]:
    """Yield the rows that are not what the audit says of them."""
    audited, since = read_audited(session)
    for one in COMPARED:
        table = Row.metadata.tables[one.__tablename__]
        (key,) = table.primary_key.columns
        there = {f"{table.name}/{row[key.name]}": dict(row) for row in session.execute(select(table)).mappings()}
        for thing, row in there.items():
            said = _describe_difference(table, row, audited.get(thing), since)
            if said:
                yield Difference(thing, audited.get(thing), row, f"Table {table.name}, row {row[key.name]}: {said}")
        for thing in sorted(thing for thing in audited if thing.startswith(f"{table.name}/") and thing not in there):
            said = f"Table {table.name}, row {thing.partition('/')[2]} is missing, and the audit says it was stored."
            yield Difference(thing, audited[thing], None, said)


def read_audited(session: Session) -> tuple[Audited, datetime | None]:
    """Return what the audit says of the rows that are compared, and when it begins."""
    names = tuple(f"{one.__tablename__}/" for one in COMPARED)
    found: Audited = {}
    since = None
    query = select(AuditRow.content).order_by(AuditRow.number).execution_options(yield_per=AT_ONCE)
    for text in session.execute(query).scalars():
        content = json.loads(text)
        since = since or datetime.fromisoformat(content["at"])
        for change in content["changes"]:
            thing, after = change["thing"], change["after"]
            if thing.startswith(f"{RobotRow.__tablename__}/") and not after:
                _forget_repairs(found, thing.partition("/")[2])
            if not thing.startswith(names):
                continue
            if after:
                found.setdefault(thing, {}).update(json.loads(after))
            else:
                found.pop(thing, None)
    return found, since


def _forget_repairs(found: Audited, robot: str) -> None:
    """Leave out the repairs of a robot that was deleted: the database deletes them with it."""
    name = f"{RepairRow.__tablename__}/"
    for thing in [one for one in found if one.startswith(name) and str(found[one].get("robot_id")) == robot]:
        del found[thing]


def _describe_difference(
    table: Table, row: dict[str, Any], audited: dict[str, Any] | None, since: datetime | None
) -> str:
    """Say how a row differs from what the audit says; empty: it does not."""
    if audited is None:
        stored = row["created_at"] if "created_at" in row else row["at"]
        old = since is None or stored < since
        return "" if old else "it was put in past Kilter, the audit has no entry of it."
    other = [name for name, value in audited.items() if name in row and not _is_same(table, name, row[name], value)]
    return f"{', '.join(other)} {'is' if len(other) == 1 else 'are'} not what the audit says." if other else ""


def _is_same(table: Table, name: str, stored: Any, audited: Any) -> bool:
    if isinstance(table.c[name].type, Instant) and stored is not None and audited is not None:
        return bool(stored == datetime.fromisoformat(audited))
    return bool(json.loads(json.dumps(hash_when_long(stored), default=str)) == audited)
