"""What a process holds in PostgreSQL when it is frozen in the middle of a change: it is freed, and others go on."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime

import pytest
from sqlalchemy import event, text
from sqlalchemy.pool import QueuePool

from kilter_service.ground.db import Database, database, revision
from kilter_service.ground.db.tables import HeartbeatRow
from tests.service.postgresql import database_of


@pytest.mark.parametrize("kind", ["transaction", "noting"])
def test_what_a_frozen_process_holds_is_freed(kind: str, postgresql: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A session that neither goes on nor ends is all that the database sees of such a process."""
    monkeypatch.setattr(database, "MOST_IDLE_S", 1)
    at = datetime.now(UTC)
    with database_of(postgresql) as url, ExitStack() as open_ones:
        frozen, other = Database(url), Database(url)
        open_ones.callback(frozen.close)
        open_ones.callback(other.close)
        revision.migrate(other)
        with other.transaction() as session:
            session.add(HeartbeatRow(process="p", name="n", pid=1, at=at))
        holder = getattr(frozen, kind)()
        held = holder.__enter__()
        held.execute(text("UPDATE heartbeats SET pid = 2"))
        with other.transaction() as session:
            session.execute(text("SET LOCAL lock_timeout = '20s'"))
            session.execute(text("UPDATE heartbeats SET pid = 3"))
        with pytest.raises(Exception, match="idle-in-transaction timeout"):
            holder.__exit__(None, None, None)
        with other.reading() as session:
            assert session.execute(text("SELECT pid FROM heartbeats")).scalar() == 3


def test_who_only_reads_may_take_its_time(postgresql: str) -> None:
    with database_of(postgresql) as url:
        reader = Database(url)
        with reader.reading() as session:
            assert session.execute(text("SHOW idle_in_transaction_session_timeout")).scalar() == "0"
        with reader.noting() as session:
            assert session.execute(text("SHOW idle_in_transaction_session_timeout")).scalar() == "10s"
        reader.close()


def test_a_connection_in_use_is_closed_when_its_thread_is_done(postgresql: str) -> None:
    """Else it stays open at the server until Python collects it, and says so in whatever test runs then."""
    with database_of(postgresql) as url:
        database_ = Database(url)
        with database_.reading() as session:
            driver = session.connection().connection.dbapi_connection
            database_.close()
        assert driver is not None
        assert driver.closed


def test_a_connection_that_comes_back_while_its_pool_closes_is_closed(postgresql: str) -> None:
    """Handed back after the queue was emptied, by a thread that had asked before whether the pool is open."""
    with database_of(postgresql) as url:
        database_ = Database(url)
        pool = database_.engine.pool
        event.listen(database_.engine, "checkin", lambda *_: database_.close())
        with database_.reading() as session:
            driver = session.connection().connection.dbapi_connection
        assert driver is not None
        assert driver.closed
        assert isinstance(pool, QueuePool)
        assert pool.checkedin() == 0
