"""Processes that wait for something to do ask on one connection, and see what others store."""

from __future__ import annotations

import threading
from typing import Any

import httpx
import pytest
from sqlalchemy import event, select

from kilter_service.ground.db import Database, DatabaseAwayError
from kilter_service.ground.db.database import Lookout
from kilter_service.ground.db.tables import RobotRow
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from kilter_service.jobs.work.worker import QueueConsumer
from kilter_service.stream.corrector.active import DatabaseSource
from tests.service.conftest import Katana

ROBOTS = select(RobotRow.name).where(RobotRow.name.in_(["katana", "100% :x"])).order_by(RobotRow.name)


class Work:
    """Counts what an engine opens and is asked through sessions."""

    def __init__(self, database: Database) -> None:
        self.connections = self.statements = 0
        event.listen(database.engine, "connect", self._connected)
        event.listen(database.engine, "before_cursor_execute", self._asked)

    def _connected(self, *_: Any) -> None:
        self.connections += 1

    def _asked(self, *_: Any) -> None:
        self.statements += 1


@pytest.mark.both_databases
def test_a_lookout_sees_what_others_store_and_opens_no_session(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    watched = Database(database.url)
    work, lookout = Work(watched), Lookout(watched, ROBOTS, ROBOTS)
    assert lookout.rows() == []
    client.post("/v1/robots", json=katana.document).raise_for_status()
    assert [lookout.rows() for _ in range(50)] == [[("katana",), ("katana",)]] * 50
    client.post("/v1/robots/katana/purge", json={})
    assert (work.connections, work.statements) == (1, 0)
    lookout.close()
    watched.close()


def test_a_lookout_says_that_the_database_is_away_and_goes_on_after() -> None:
    away = Database("postgresql://nobody@127.0.0.1:1/none")
    lookout = Lookout(away, ROBOTS)
    with pytest.raises(DatabaseAwayError):
        lookout.rows()
    away.close()


def test_a_lookout_opens_a_new_connection_after_one_that_broke(database: Database) -> None:
    lookout = Lookout(database, ROBOTS)
    assert lookout.rows() == []
    assert lookout._connection is not None
    lookout._connection.close()
    assert lookout.rows() == []  # asked by a session
    assert lookout.rows() == []
    lookout.close()


def test_an_idle_queue_and_an_idle_corrector_open_no_session(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    stop = threading.Event()
    queue = QueueConsumer(database, Runner(database, stop), "w", ["identify"], stop)
    source = DatabaseSource(database.url)
    idle = source.stamp()
    work = Work(database), Work(source._database)
    assert [queue._claim_next_job() for _ in range(20)] == [None] * 20
    assert {source.stamp() for _ in range(20)} == {idle}
    assert [one.statements for one in work] == [0, 0]
    job = {"kind": "identify", "robot": "katana", "campaigns": [katana.campaign(client, 20)]}
    queued = client.post("/v1/jobs", json=job).raise_for_status().json()["id"]
    claim = queue._claim_next_job()
    assert claim is not None
    assert claim.job_id == queued
    with database.reading() as session:
        assert store.holds(session, claim)
    client.patch("/v1/robots/katana", json={"controller_compensation": "factory"}).raise_for_status()
    assert source.stamp() != idle
    source.close()
