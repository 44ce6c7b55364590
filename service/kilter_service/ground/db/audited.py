"""The audit: every transaction of a request that changes something leaves one entry, in the same transaction.

What was changed is taken from the session, so that no feature has to remember it. An entry is a text; its hash covers the
text and the hash before it, so that an entry that is changed, left out or put in between is seen.
"""

from __future__ import annotations

import hashlib
import json
import logging
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ClauseElement, event, insert, inspect, select
from sqlalchemy.orm import ORMExecuteState, Session, sessionmaker

from kilter_service.ground.caller import CALLER, Caller
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.tables import AuditRow, EndedJobsRow, HeartbeatRow, LoginRow

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
