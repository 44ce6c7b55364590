"""One database, opened when it is asked for: SQLite in WAL mode, or PostgreSQL by its URL.

A transaction says when it begins whether it writes. One that does holds the only write lock until it ends, so that nothing
it has read can be out of date when it writes; one that only reads sees one snapshot of the database, waits for nobody, and
the database itself refuses its writes.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import weakref
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, Select, create_engine, event, make_url
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session, sessionmaker
from sqlalchemy.pool import ConnectionPoolEntry, QueuePool

from kilter_service.ground.db import audited, sealed, seals
from kilter_service.ground.db.audited import AuditedTokens
from kilter_service.ground.db.failures import AWAY_CODE, FAILED_CODE, FULL_CODE, READ_ONLY, READ_ONLY_CODE, in_words
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import private_file, private_folder

BUSY_TIMEOUT_MS = 15_000
CONNECT_TIMEOUT_S = 5
LOOK_TIMEOUT_S = 2  # the shortest that libpq knows
# A machine that loses its power says nothing. We ask after this long, and take an unanswered query for lost.
SILENCE = {"keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3, "tcp_user_timeout": 25_000}
# PostgreSQL asks, too, and frees the write lock that the machine held.
KEEPALIVES = {"tcp_keepalives_idle": 10, "tcp_keepalives_interval": 5, "tcp_keepalives_count": 3}
# A frozen process answers such questions and still holds its locks; a change takes milliseconds between its queries. Less
# than a client waits for an answer, which may be waiting for that lock.
MOST_IDLE_S = 10
READS = "kilter_reads"  # execution option of connections that only read
NOTES = "kilter_notes"  # of those that change one row by one statement
WRITER = 0x4B_69_6C_74_65_72  # "Kilter": the advisory lock of PostgreSQL that whoever changes something holds


class Database:
    """An engine and its sessions; close it when its owner stops."""

    def __init__(self, url: str, connect_timeout_s: int = CONNECT_TIMEOUT_S) -> None:
        self.url = url
        self.engine = open_engine(url, connect_timeout_s)
        file = self.engine.url.database if self.engine.dialect.name == "sqlite" else None
        self._folder = Path(file).parent if file else None
        self.sealer = seals.sealer()
        self.audited_tokens = AuditedTokens()
        self._changing = sessionmaker(self.engine, expire_on_commit=False)
        audited.listen(self._changing)
        sealed.listen(self._changing, self.sealer)
        self._noting = sessionmaker(self.engine.execution_options(**{NOTES: True}), expire_on_commit=False)
        self._reading = sessionmaker(self.engine.execution_options(**{READS: True}), expire_on_commit=False)

    def transaction(self) -> AbstractContextManager[Session]:
        """Open a session that may write.

        It commits when the block ends and rolls back when it raises. Other writers wait until then: keep it short, compute
        outside it, and never open one inside another.
        """
        return self._session(self._changing)

    def noting(self) -> AbstractContextManager[Session]:
        """Open a session for one statement that changes one row, such as a job's progress.

        On PostgreSQL it waits only for who changes the same row: many workers note their progress several times a second.
        """
        return self._session(self._noting)

    def reading(self) -> AbstractContextManager[Session]:
        """Open a session that sees the database as it is at its first query. The database refuses its writes."""
        return self._session(self._reading)

    @contextmanager
    def looking(self) -> Iterator[Database]:
        """Open it anew for whoever asks whether it answers: soon or not at all, also where a connection in use hangs."""
        if self.engine.dialect.name == "sqlite":
            yield self
            return
        with closing(Database(self.url, LOOK_TIMEOUT_S)) as looked:
            yield looked

    @contextmanager
    def _session(self, sessions: sessionmaker[Session]) -> Iterator[Session]:
        with outages(self._folder, writes=sessions is not self._reading), sessions.begin() as session:
            yield session

    def close(self) -> None:
        """Close all connections; those that a thread still uses, when it is done with them."""
        self.engine.pool.dispose()


class _Pool(QueuePool):
    """Connections of one database. Once it is disposed of it keeps none: one that comes back late is closed."""

    _disposed = False

    def dispose(self) -> None:
        self._disposed = True
        super().dispose()

    def _do_return_conn(self, record: ConnectionPoolEntry) -> None:
        super()._do_return_conn(record)
        if self._disposed:  # asked last: whoever disposes meanwhile finds the connection in the queue, or we find this
            super().dispose()


def open_engine(url: str, connect_timeout_s: int = CONNECT_TIMEOUT_S) -> Engine:
    """Create the engine of ``url`` and, for SQLite, the folder of its file. Its transactions may change something."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        engine = _postgresql(parsed, connect_timeout_s)
        event.listen(engine, "connect", _prepare_postgresql)
        event.listen(engine, "begin", _begin_postgresql)
        return engine
    if parsed.database:
        private_folder(Path(parsed.database).parent)
        private_file(Path(parsed.database))  # SQLite gives its -wal and -shm the same rights
    engine = create_engine(parsed, poolclass=_Pool if parsed.database else None)
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _postgresql(url: URL, connect_timeout_s: int) -> Engine:
    try:
        return create_engine(
            url.set(drivername="postgresql+psycopg"),
            pool_pre_ping=True,
            poolclass=_Pool,
            connect_args={"connect_timeout": connect_timeout_s, **SILENCE},
        )
    except ModuleNotFoundError as error:
        raise DatabaseAwayError(
            f"KILTER_DATABASE_URL names a PostgreSQL database, and its driver is not installed ({error.name}): "
            "pip install 'psycopg[binary]'."
        ) from error


def _prepare_sqlite(connection: Any, _record: Any) -> None:
    # None: the driver begins no transaction by itself. It would do so at the first change, after all that was read.
    connection.isolation_level = None
    # FULL: what was acknowledged is on the disk, also when the power goes (docs/explanation/durability.md has the cost).
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={BUSY_TIMEOUT_MS}"):
        try:
            connection.execute(f"PRAGMA {pragma}")
        except UnicodeDecodeError as error:  # SQLite repeats a name in the schema that is not text any more
            raise sqlite3.DatabaseError("malformed database schema") from error


def _prepare_postgresql(connection: Any, _record: Any) -> None:
    words = [f"SET {name} = {value}" for name, value in KEEPALIVES.items()]
    words.append("SET default_transaction_isolation = 'read committed'")
    words.append(f"SET idle_in_transaction_session_timeout = '{MOST_IDLE_S}s'")
    with connection.cursor() as cursor:
        cursor.execute("; ".join(words))
    connection.commit()


def _begin_sqlite(connection: Connection) -> None:
    reads = connection.get_execution_options().get(READS, False)
    connection.exec_driver_sql(f"PRAGMA query_only={'ON' if reads else 'OFF'}")  # the pool hands out both kinds
    # IMMEDIATE: whoever changes something waits here, before it reads.
    connection.exec_driver_sql("BEGIN" if reads else "BEGIN IMMEDIATE")


def _begin_postgresql(connection: Connection) -> None:
    if connection.get_execution_options().get(READS, False):
        # Who reads holds nobody up, and may send on what it reads for minutes.
        connection.exec_driver_sql(
            "SET TRANSACTION ISOLATION LEVEL REPEATABLE READ, READ ONLY; SET LOCAL idle_in_transaction_session_timeout = 0"
        )
        return
    if connection.get_execution_options().get(NOTES, False):
        return  # a statement locks the row it changes
    # READ COMMITTED: every query after the lock sees what the holder before has stored.
    connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL READ COMMITTED")
    connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({WRITER})")


class DatabaseAwayError(ServiceError):
    """The database does not answer now; what was asked of it was not stored, or it cannot be told."""

    default_code = AWAY_CODE


def is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is mounted read-only, or takes nothing more after an error of its disk."""
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        return True
    try:  # since Linux 6.15 the flags do not say the second (ext4: emergency_ro)
        os.close(os.open(folder, getattr(os, "O_TMPFILE", 0) | os.O_WRONLY, 0o600))
    except OSError as error:
        return error.errno == errno.EROFS
    return False


@contextmanager
def outages(folder: Path | None = None, *, writes: bool = True) -> Iterator[None]:
    """Raise ``DatabaseAwayError`` where the server is gone or the disk full or read-only, of SQLite that of ``folder``.

    Other errors pass; so does a write that the database refuses to a session that only reads.
    """
    try:
        yield
    except DBAPIError as error:
        known = in_words(error)
        # SQLite calls it a failure when the kernel refuses to write to a file that was open before.
        if known is not None and known.code == FAILED_CODE and folder is not None and is_read_only(folder):
            raise DatabaseAwayError(READ_ONLY, code=READ_ONLY_CODE) from error
        if known is None or known.code not in (AWAY_CODE, FULL_CODE, READ_ONLY_CODE):
            raise
        if known.code == READ_ONLY_CODE and not writes and (folder is None or not is_read_only(folder)):
            raise
        raise DatabaseAwayError(known.message, code=known.code) from error


class Lookout:
    """Asks whether there is anything to do, for a thirtieth of the time of a session; for one thread."""

    def __init__(self, database: Database, *queries: Select[Any]) -> None:
        self._database, self._queries = database, queries
        dialect = database.engine.dialect
        compiled = [query.compile(dialect=dialect, compile_kwargs={"render_postcompile": True}) for query in queries]
        self._statements = [
            (one.string, one.params if one.positiontup is None else tuple(one.params[name] for name in one.positiontup))
            for one in compiled
        ]
        self._connection: Any = None

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the rows of the queries, one after the other; what is wrong with the database is raised as by a session."""
        try:
            cursor = self._connected().cursor()
            return [tuple(row) for statement in self._statements for row in cursor.execute(*statement).fetchall()]
        except Exception:
            self.close()
            with self._database.reading() as session:
                return [tuple(row) for query in self._queries for row in session.execute(query)]

    def _connected(self) -> Any:
        if self._connection is None:
            pooled = self._database.engine.raw_connection()
            self._connection = found = pooled.dbapi_connection
            # Out of the pool, which hands out none that commits by itself, and would log the roll-back of one that is lost.
            pooled.detach()
            self._closing = weakref.finalize(self, found.close)  # type: ignore[union-attr]
            if self._database.engine.dialect.name != "sqlite":
                self._connection.autocommit = True
        return self._connection

    def close(self) -> None:
        """Close the connection; the next question opens another."""
        if self._connection is not None:
            self._connection = None
            with contextlib.suppress(Exception):  # of a connection that is lost
                self._closing()
