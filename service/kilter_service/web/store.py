"""Rows of tokens, of the secret only its hash; of logins, the audit, first answers, processes that are alive, and numbers."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from types import MappingProxyType
from typing import Any, NamedTuple

from sqlalchemy import and_, delete, func, or_, select

from kilter_service.contract.server import Role, Token
from kilter_service.ground.caller import CALLER
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import (
    AnsweredRow,
    AuditRow,
    EndedJobsRow,
    HeartbeatRow,
    JobRow,
    LoginRow,
    TokenRow,
)
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import ALL, Page
from kilter_service.ground.store import NEVER_RAN


def add(
    session: Session,
    sha256: str,
    name: str,
    role: Role,
    robots: Sequence[str] | None,
    expires_at: datetime | None,
    actor: str,
) -> Token:
    """Store a new token by the hash of its secret.

    Raises:
        ServiceError: another one that still works has the name.

    """
    taken = select(TokenRow).where(TokenRow.name == name, TokenRow.revoked_at.is_(None))
    for other in session.execute(taken).scalars():
        if other.expires_at is None or other.expires_at > utc_now():
            raise ServiceError(
                f"There is a token called {name!r} already, {other.id}: give another name, or revoke that one "
                f"(kilter server token revoke {other.id}).",
                code="name_taken",
                name=name,
                id=other.id,
            )
    row = TokenRow(
        id=f"tok_{uuid.uuid4().hex[:16]}",
        name=name,
        sha256=sha256,
        role=role,
        robots=None if robots is None else sorted(set(robots)),
        created_by=actor,
        expires_at=expires_at,
    )
    session.add(row)
    session.flush()
    return copy_fields(Token, row)


def by_hash(session: Session, sha256: str) -> Token | None:
    """Return the token whose secret has this hash."""
    row = session.execute(select(TokenRow).where(TokenRow.sha256 == sha256)).scalar_one_or_none()
    return None if row is None else copy_fields(Token, row)


def tokens_on_page(session: Session, page: Page) -> list[Token]:
    """Return tokens, newest first, one more than the page shows; those that ended too."""
    row = TokenRow
    query = select(row).order_by(row.created_at.desc(), row.id)
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(or_(row.created_at < moment, and_(row.created_at == moment, row.id > key)))
    return [copy_fields(Token, found) for found in session.execute(query.limit(page.fetch_limit)).scalars()]


def revoke(session: Session, token_id: str, actor: str) -> Token:
    """End a token; nothing changes when it was revoked already.

    Raises:
        ServiceError: there is none.

    """
    row = session.get(TokenRow, token_id)
    if row is None:
        raise ServiceError(
            f"There is no token {token_id!r}: list them with `kilter server token list`.",
            code="token_not_found",
            id=token_id,
        )
    if row.revoked_at is None:
        row.revoked_at, row.revoked_by = utc_now(), actor
        session.flush()
    return copy_fields(Token, row)


def left_s(session: Session) -> float:
    """Return how long the token of the caller holds, s; infinite for the server's own.

    Raises:
        ServiceError: it has ended since the request was let in.

    """
    caller = CALLER.get()
    row = None if caller is None or not caller.token_id else session.get(TokenRow, caller.token_id)
    if row is None:
        return float("inf")
    left = float("inf") if row.expires_at is None else (row.expires_at - utc_now()).total_seconds()
    if row.revoked_at is not None or left <= 0.0:
        raise ServiceError(
            f"Token {row.name!r} has ended: ask an admin for a new one.", code="token_ended", name=row.name
        )
    return left


AT_ONCE = 500


class AuditRecord(NamedTuple):
    """An entry as it is stored."""

    number: int
    previous: str
    sha256: str
    content: str


def entries_on_page(session: Session, page: Page = ALL) -> list[AuditRecord]:
    """Return entries, oldest first, one more than the page shows."""
    row = AuditRow
    query = select(row.number, row.previous, row.sha256, row.content).order_by(row.number)
    if page.number is not None:
        query = query.where(row.number > page.number)
    return [AuditRecord(*found) for found in session.execute(query.limit(page.fetch_limit))]


def everything(session: Session) -> Iterator[AuditRecord]:
    """Yield all entries, oldest first, few at a time."""
    row = AuditRow
    query = select(row.number, row.previous, row.sha256, row.content).order_by(row.number)
    with session.execute(
        query.execution_options(yield_per=AT_ONCE)
    ) as entries:  # ended also where a reader stops half-way
        yield from (AuditRecord(*found) for found in entries)


KEPT_FOR = timedelta(days=7)


def answer(session: Session, key_id: str) -> tuple[str, dict[str, Any]] | None:
    """Return the hash of the first body that came under a key, and what it was answered with."""
    row = session.get(AnsweredRow, key_id)
    return None if row is None else (row.body_sha256, row.answer)


def keep(session: Session, key_id: str, body_sha256: str, document: dict[str, Any]) -> None:
    """Keep the answer of a request that is done in this transaction; forget those of long ago."""
    session.execute(delete(AnsweredRow).where(AnsweredRow.at < utc_now() - KEPT_FOR))
    session.add(AnsweredRow(id=key_id, body_sha256=body_sha256, answer=document))
    session.flush()


class Heartbeat(NamedTuple):
    """A process and how long ago, in seconds, it said that it is alive; negative: in the future."""

    name: str
    age_s: float


def beat(
    session: Session, process: str, name: str, pid: int, details: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Say that a process ("worker", "corrector", "ros2") called ``name`` is alive now, and what it does."""
    session.merge(HeartbeatRow(process=process, name=name, pid=pid, at=utc_now(), details=dict(details)))


def silence(session: Session, process: str, name: str) -> None:
    """Say that a process has stopped."""
    row = session.get(HeartbeatRow, (process, name))
    if row is not None:
        session.delete(row)


def heartbeats(session: Session, process: str) -> list[Heartbeat]:
    """Return when the processes of a kind, which have not stopped by themselves, last said that they are alive."""
    rows = session.execute(select(HeartbeatRow).where(HeartbeatRow.process == process).order_by(HeartbeatRow.name))
    at = utc_now()
    return [Heartbeat(row.name, (at - row.at).total_seconds()) for row in rows.scalars()]


@dataclass(frozen=True)
class Ended:
    """Jobs of a kind and an end: how many there were, how many of those that ran took at most so long, and all together."""

    jobs: int = 0
    seconds: float = 0.0
    at_most_ms: Mapping[int, int] = field(default_factory=dict)


def jobs_by_state(session: Session) -> list[tuple[str, str, int]]:
    """Return kind, state and number of all jobs."""
    query = select(JobRow.kind, JobRow.state, func.count()).group_by(JobRow.kind, JobRow.state)
    return [(kind, state, number) for kind, state, number in session.execute(query)]


def queue_age_s(session: Session) -> float:
    """Return for how long the oldest queued job has waited, 0 without one."""
    oldest = session.execute(select(func.min(JobRow.created_at)).where(JobRow.state == "queued")).scalar_one()
    return 0.0 if oldest is None else max(0.0, (utc_now() - oldest).total_seconds())


def ended_jobs(session: Session) -> dict[tuple[str, str], Ended]:
    """Return by kind and state what was counted of all jobs that have ended, also of those that were purged."""
    found: dict[tuple[str, str], Ended] = {}
    for row in session.execute(select(EndedJobsRow).order_by(EndedJobsRow.at_most_ms)).scalars():
        before = found.get((row.kind, row.state), Ended())
        ran = {row.at_most_ms: row.jobs} if row.at_most_ms != NEVER_RAN else {}
        found[row.kind, row.state] = Ended(
            before.jobs + row.jobs, before.seconds + row.seconds, {**before.at_most_ms, **ran}
        )
    return found


def beats(session: Session) -> list[tuple[str, str, float]]:
    """Return kind, name and seconds since the last sign of life of every process of the server.

    Bridges are none: one that has ended is remembered.
    """
    moment = utc_now()
    rows = session.execute(select(HeartbeatRow).where(HeartbeatRow.process != "bridge")).scalars()
    return [(row.process, row.name, (moment - row.at).total_seconds()) for row in rows]


def webhooks(session: Session) -> dict[str, dict[str, int]]:
    """Return how many verdicts each worker that has a webhook has posted and given up, by its name."""
    query = select(HeartbeatRow.name, HeartbeatRow.details).where(HeartbeatRow.process == "worker")
    return {name: details["webhook"] for name, details in session.execute(query) if "webhook" in (details or {})}


def streams(session: Session) -> list[dict[str, Any]]:
    """Return what every stream of every corrector that runs has last said of itself."""
    query = select(HeartbeatRow.details).where(HeartbeatRow.process == "corrector")
    return [stream for details in session.execute(query).scalars() for stream in details.get("streams", [])]


def add_login(session: Session, sha256: str, token_sha256: str, expires_at: datetime) -> None:
    """Store a login by the hash of its secret."""
    session.add(LoginRow(sha256=sha256, token_sha256=token_sha256, expires_at=expires_at))


def login_token_hash(session: Session, sha256: str) -> str | None:
    """Return the hash of a login's token; None: there is no such login any more."""
    query = select(LoginRow.token_sha256).where(LoginRow.sha256 == sha256, LoginRow.expires_at > utc_now())
    return session.execute(query).scalar_one_or_none()


def consume_login(session: Session, sha256: str) -> str | None:
    """Delete a login and return the hash of its token; None: there is none any more, or somebody else took it."""
    row = LoginRow
    query = delete(row).where(row.sha256 == sha256, row.expires_at > utc_now()).returning(row.token_sha256)
    return session.execute(query).scalar_one_or_none()


def forget(session: Session, sha256: str) -> None:
    """Delete a login."""
    session.execute(delete(LoginRow).where(LoginRow.sha256 == sha256))


def forget_ended(session: Session) -> None:
    """Delete the logins that ended."""
    session.execute(delete(LoginRow).where(LoginRow.expires_at <= utc_now()))
