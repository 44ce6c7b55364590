"""Whether tokens, activations and repairs are what the audit says of them: rights, and what arms are sent, rest on these.

The audit has who stored, changed or removed each of them, in a chain of its own. So a row that was put back to an earlier
state is found, whoever computed its seals anew. Of the three only activations may be older than the audit.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from datetime import datetime
from threading import Lock
from typing import Any, NamedTuple

from sqlalchemy import Table, or_, select
from sqlalchemy.orm import Session

from kilter_service.ground.db.audited import hash_when_long
from kilter_service.ground.db.database_seal import audit_end
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
    audited = read_audited(session, COMPARED)
    old = _activations_before_audit(session, audited)
    for one in COMPARED:
        table = Row.metadata.tables[one.__tablename__]
        (key,) = table.primary_key.columns
        there = {f"{table.name}/{row[key.name]}": dict(row) for row in session.execute(select(table)).mappings()}
        for thing, row in there.items():
            said = "" if thing in old else _describe_difference(table, row, audited.get(thing))
            if said:
                yield Difference(thing, audited.get(thing), row, f"Table {table.name}, row {row[key.name]}: {said}")
        for thing in sorted(thing for thing in audited if thing.startswith(f"{table.name}/") and thing not in there):
            said = f"Table {table.name}, row {thing.partition('/')[2]} is missing, and the audit says it was stored."
            yield Difference(thing, audited[thing], None, said)


class AuditedTokens:
    """What the audit says of tokens, kept for a process: a token that was put back in the files does not work again."""

    def __init__(self) -> None:
        self._end: list[Any] = [0, ""]
        self._rows: Audited = {}
        self._reading = Lock()

    def describe_difference(self, session: Session, token_id: str) -> str:
        """Say how a stored token differs from what the audit says of it; empty: it does not."""
        table = Row.metadata.tables[TokenRow.__tablename__]
        row = session.execute(select(table).where(table.c.id == token_id)).mappings().one()
        with self._reading:
            self._read_on(session)
            return _describe_difference(table, dict(row), self._rows.get(f"{table.name}/{token_id}"))

    def _read_on(self, session: Session) -> None:
        """Read the entries that are new; all, where the last one is not there any more: another database is in place."""
        end = audit_end(session.connection())
        if end == self._end:
            return
        number, sha256 = self._end
        if session.execute(select(AuditRow.sha256).where(AuditRow.number == number)).scalar() != sha256:
            number, self._rows = 0, {}
        read_audited(session, (TokenRow,), number, self._rows)
        self._end = end


def _activations_before_audit(session: Session, audited: Audited) -> set[str]:
    """Return the activations from before the audit: dated before it began, numbered before all that it has.

    Versions that the audit saw being stored were activated by nobody before it.
    """
    table = ActivationRow.__tablename__
    named = [int(key) for name, _, key in (thing.partition("/") for thing in audited) if name == table]
    query = select(ActivationRow.id, ActivationRow.version_id)
    query = query.where(ActivationRow.id < min(named)) if named else query
    text = session.execute(select(AuditRow.content).order_by(AuditRow.number).limit(1)).scalar()
    if text is not None:
        query = query.where(ActivationRow.at < datetime.fromisoformat(json.loads(text)["at"]))
    candidates = session.execute(query).all()
    return {f"{table}/{key}" for key, version in candidates if not _was_stored(session, f"versions/{version}")}


def _was_stored(session: Session, thing: str) -> bool:
    """Say whether the audit has an entry by which a row was stored."""
    query = select(AuditRow.content).where(AuditRow.content.contains(f'"{thing}"'))
    changes = (change for text in session.execute(query).scalars() for change in json.loads(text)["changes"])
    return any(change["thing"] == thing and not change["before"] and change["after"] for change in changes)


def read_audited(
    session: Session, compared: Sequence[type[Row]], after: int = 0, found: Audited | None = None
) -> Audited:
    """Return what the audit says of rows of these tables; to ``found`` it adds what entries behind number ``after`` say."""
    names = tuple(f"{one.__tablename__}/" for one in compared)
    found = {} if found is None else found
    mentioned = or_(*(AuditRow.content.contains(f'"{name}') for name in (*names, f"{RobotRow.__tablename__}/")))
    query = select(AuditRow.content).where(AuditRow.number > after, mentioned).order_by(AuditRow.number)
    with session.execute(query.execution_options(yield_per=AT_ONCE)) as entries:
        changes = (change for text in entries.scalars() for change in json.loads(text)["changes"])
        for thing, after_change in ((change["thing"], change["after"]) for change in changes):
            if thing.startswith(f"{RobotRow.__tablename__}/") and not after_change:
                _forget_repairs(found, thing.partition("/")[2])
            if not thing.startswith(names):
                continue
            if after_change:
                found.setdefault(thing, {}).update(json.loads(after_change))
            else:
                found.pop(thing, None)
    return found


def _forget_repairs(found: Audited, robot: str) -> None:
    """Leave out the repairs of a robot that was deleted: the database deletes them with it."""
    name = f"{RepairRow.__tablename__}/"
    for thing in [one for one in found if one.startswith(name) and str(found[one].get("robot_id")) == robot]:
        del found[thing]


def _describe_difference(table: Table, row: dict[str, Any], audited: dict[str, Any] | None) -> str:
    """Say how a row differs from what the audit says; empty: it does not."""
    if audited is None:
        return "it was put in past Kilter, the audit has no entry of it."
    other = [name for name, value in audited.items() if name in row and not _is_same(table, name, row[name], value)]
    return f"{', '.join(other)} {'is' if len(other) == 1 else 'are'} not what the audit says." if other else ""


def _is_same(table: Table, name: str, stored: Any, audited: Any) -> bool:
    if isinstance(table.c[name].type, Instant) and stored is not None and audited is not None:
        return bool(stored == datetime.fromisoformat(audited))
    return bool(json.loads(json.dumps(hash_when_long(stored), default=str)) == audited)
