"""The audit: every transaction of a request that changes something leaves one entry, in the same transaction.

What was changed is taken from the session, so that no feature has to remember it. An entry is a text; its hash covers the
text and the hash before it, so that an entry that is changed, left out or put in between is seen.

Whether tokens, activations and repairs are what the audit says of them: rights, and what arms are sent, rest on these.

The audit has who stored, changed or removed each of them, in a chain of its own. So a row that was put back to an earlier
state is found, whoever computed its seals anew. Of the three only activations may be older than the audit.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from threading import Lock
from typing import Any, NamedTuple

from sqlalchemy import ClauseElement, Table, event, insert, inspect, or_, select
from sqlalchemy.orm import ORMExecuteState, Session, sessionmaker

from kilter_service.ground.caller import CALLER, Caller
from kilter_service.ground.db.database_seal import audit_end
from kilter_service.ground.db.row import Instant, Row
from kilter_service.ground.db.tables import (
    ActivationRow,
    AuditRow,
    EndedJobsRow,
    HeartbeatRow,
    LoginRow,
    RepairRow,
    RobotRow,
    TokenRow,
)

log = logging.getLogger("kilter.audit")

CHANGES, TOLD = "kilter_changes", "kilter_told"
MOST_CHANGES, MOST_CHARACTERS = 100, 2000
# Logins are noted in words: nobody is helped by the hash of a secret. That a job ended is noted with the job.
LEFT_OUT = (AuditRow, EndedJobsRow, HeartbeatRow, LoginRow)


def listen(sessions: sessionmaker[Session]) -> None:
    """Record what the sessions of a maker change."""
    event.listen(sessions, "after_flush", _record_flush)
    event.listen(sessions, "do_orm_execute", _record_bulk_statement)
    event.listen(sessions, "before_commit", _append)
    event.listen(sessions, "after_commit", _log_audit_head)


def note(session: Session, thing: str, before: object, after: object) -> None:
    """Record what no single row says, for instance which version was active before."""
    _keep(session, thing, _text(before), _text(after))


def _keep(session: Session, thing: str, before: str, after: str) -> None:
    if CALLER.get() is not None:
        session.info.setdefault(CHANGES, []).append({"thing": thing, "before": before, "after": after})


def _record_flush(session: Session, _context: Any) -> None:
    # The keys of new rows are known now, and what was changed in the others still is.
    for row in session.new:
        _row(session, row, None, _values(row))
    for row in session.deleted:
        _row(session, row, _values(row), None)
    for row in session.dirty:
        changed = {a.key: a.history for a in inspect(row).attrs if a.history.has_changes()}
        if changed:
            before = {key: history.deleted[0] if history.deleted else None for key, history in changed.items()}
            _row(
                session,
                row,
                before,
                {key: history.added[0] if history.added else None for key, history in changed.items()},
            )


def _row(session: Session, row: Any, before: dict[str, Any] | None, after: dict[str, Any] | None) -> None:
    if isinstance(row, Row) and not isinstance(row, LEFT_OUT):
        key = "/".join(str(part) for part in inspect(type(row)).primary_key_from_instance(row))
        _keep(session, f"{row.__tablename__}/{key}", _text(before), _text(after))


def _values(row: Any) -> dict[str, Any]:
    return {attribute.key: getattr(row, attribute.key) for attribute in inspect(type(row)).column_attrs}


def _text(value: object) -> str:
    """Return a value as JSON text; of bytes, and of what is long, the hash."""
    if value is None:
        return ""
    if isinstance(value, dict):
        return json.dumps({key: hash_when_long(part) for key, part in value.items()}, sort_keys=True, default=str)
    return json.dumps(hash_when_long(value), default=str)


def hash_when_long(value: Any) -> Any:
    """Return a value; of bytes, and of what is long, its hash."""
    written = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True, default=str).encode()
    if isinstance(value, bytes) or len(written) > MOST_CHARACTERS:
        return {"sha256": hashlib.sha256(written).hexdigest(), "bytes": len(written)}
    return value


def _record_bulk_statement(state: ORMExecuteState) -> None:
    """Record deletions and updates of many rows by one statement, which touch no object."""
    if state.is_delete or state.is_update:
        table = getattr(state.statement, "table", None)
        name = getattr(table, "name", "")
        if name == LoginRow.__tablename__:
            return
        verb = "deleted" if state.is_delete else "changed"
        _keep(state.session, f"{name}/*", _text(f"{verb} where {_format_where_clause(state)}"), "")


def _format_where_clause(state: ORMExecuteState) -> str:
    assert isinstance(state.statement, ClauseElement)
    compiled = state.statement.compile()
    return f"{str(compiled).partition('WHERE')[2].strip()} {dict(compiled.params)}"


def _append(session: Session) -> None:
    session.flush()
    session.info.pop(TOLD, None)
    changes, caller = session.info.pop(CHANGES, []), CALLER.get()
    if not changes or caller is None:
        return
    last = session.execute(select(AuditRow.number, AuditRow.sha256).order_by(AuditRow.number.desc()).limit(1)).first()
    number, previous = (1, "") if last is None else (last.number + 1, last.sha256)
    content = _content(number, caller, changes)
    sha256 = hash_entry(previous, content)
    session.execute(insert(AuditRow).values(number=number, previous=previous, sha256=sha256, content=content))
    session.info[TOLD] = number, sha256


def _log_audit_head(session: Session) -> None:
    """Write the end of the audit into the log: whoever rewrites or cuts the database does not reach the journal."""
    told = session.info.pop(TOLD, None)
    if told is not None:
        log.info("the audit stands at %d:%s", *told)


def _content(number: int, caller: Caller, changes: list[dict[str, str]]) -> str:
    return json.dumps(
        {
            "number": number,
            "at": datetime.now(UTC).isoformat(),
            "actor": caller.actor,
            "token_id": caller.token_id,
            "role": caller.role,
            "address": caller.address,
            "route": caller.route,
            "place": json.dumps(dict(caller.ids), sort_keys=True),
            "changes": changes[:MOST_CHANGES],
            "more": max(0, len(changes) - MOST_CHANGES),
        }
    )


def hash_entry(previous: str, content: str) -> str:
    """Return the hash of an entry."""
    return hashlib.sha256(f"{previous}\n{content}".encode()).hexdigest()


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
            self._read_new_entries(session)
            return _describe_difference(table, dict(row), self._rows.get(f"{table.name}/{token_id}"))

    def _read_new_entries(self, session: Session) -> None:
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
