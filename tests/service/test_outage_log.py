"""What the log says while the database is away: a line of each part that misses it, and one that it is back."""

from __future__ import annotations

import json
import logging
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.db.failures import Failing, log_failure
from kilter_service.ground.db.revision import migrate
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.token import admin_token
from kilter_service.web.pulse import Pulse
from tests.service.forked import ForkedPopen
from tests.service.postgresql import PostgreSql, own_postgresql, programs

Until = Callable[..., None]
ROBOT = {"name": "arm", "convention": "preset", "preset": "ur10"}
PARTS = (
    "the metrics of the database cannot be read",
    "the check of database failed",
    "corrector cannot say in the database that it is alive",
    "the active versions cannot be read",
    "the streams that are looked at cannot be looked up",
    "This worker goes on when that is over",
)
MOST_CHARACTERS = 600  # of a line: the sentence, its remedy, the driver's first line


@pytest.fixture
def postgresql_of_its_own() -> Iterator[PostgreSql]:
    if programs() is None:
        pytest.skip("no PostgreSQL server is installed: apt-get install postgresql")
    with own_postgresql() as server:
        yield server


def test_each_part_of_a_server_says_in_one_line_that_its_database_is_away(
    postgresql_of_its_own: PostgreSql, settings: Settings, until: Until, tmp_path: Path
) -> None:
    settings = settings.model_copy(update={"database_url": postgresql_of_its_own.url})
    log = tmp_path / "log"
    command = [sys.executable, "-m", "kilter_service", "serve"]
    environment = {**os.environ, **settings.environment()}
    with (
        log.open("w") as file,
        ForkedPopen(command, env=environment, stdout=subprocess.PIPE, stderr=file) as server,
    ):
        try:
            assert server.stdout is not None
            url = json.loads(server.stdout.readline())["url"]
            headers = {"Authorization": f"Bearer {admin_token(settings)}"}
            with httpx.Client(base_url=url, headers=headers, timeout=30, trust_env=False) as client:
                _outage(client, postgresql_of_its_own, log, until)
        finally:
            server.terminate()
            server.wait(30)
    said = log.read_text()
    assert "Traceback" not in said
    assert max(map(len, said.splitlines())) < MOST_CHARACTERS
    for part in PARTS:
        lines = [line for line in said.splitlines() if part in line]
        assert len(lines) == 1, (part, lines)
        assert "The database cannot be reached" in lines[0]


def _outage(client: httpx.Client, database: PostgreSql, log: Path, until: Until) -> None:
    until(lambda: client.get("/v1/health/ready").status_code == 200)
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    with client.stream("GET", "/robots/arm/stream/events") as followed:
        lines = followed.iter_lines()  # kept: it closes the answer with itself
        assert next(lines)
        database.stop()
        for _ in range(4):  # as what watches a server does
            assert "kilter_database_up 0.0" in client.get("/metrics").text
            assert not client.get("/v1/health").json()["checks"]["database"]["ok"]
        until(lambda: all(part in log.read_text() for part in PARTS), seconds=60)
        database.start()
        until(lambda: client.get("/v1/health/ready").status_code == 200)
        assert "kilter_database_up 1.0" in client.get("/metrics").text


def test_a_process_waits_for_the_tables_of_a_new_database(
    tmp_path: Path, until: Until, caplog: pytest.LogCaptureFixture
) -> None:
    settings, told = Settings(data=tmp_path), []

    def details() -> dict[str, Any]:
        told.append("alive")
        return {}

    with Pulse(settings, "corrector", "local", details=details):
        until(lambda: any(tmp_path.iterdir()))  # it has asked the database once
        database = Database(settings.database)
        migrate(database)
        database.close()
        until(lambda: bool(told))
    assert [record for record in caplog.records if record.exc_info] == []  # SQLite may be busy, in one line


def test_what_fails_again_and_again_is_said_once_until_it_worked(
    caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    failing = Failing(logging.getLogger("kilter.test"), "%s cannot be read", "this")
    error = _unreadable(tmp_path)
    for _ in range(3):
        failing.report_failure(error)
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == ["this cannot be read"]
    assert caplog.records[0].exc_info is None
    failing.report_success()
    failing.report_failure(error)
    assert len(caplog.records) == 2


def test_only_what_nobody_foresaw_has_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    log = logging.getLogger("kilter.test")
    log_failure(log, ServiceError("The arm has no flange: add one."), "job %s failed", "job_1")
    try:
        try:
            raise ServiceError("The arm has no flange: add one.")
        except ServiceError:
            dict[str, str]()["missing"]
    except KeyError as error:  # a mistake in what answers a refusal is one all the same
        log_failure(log, error, "job %s failed", "job_2")
    assert [bool(record.exc_info) for record in caplog.records] == [False, True]
    assert caplog.records[0].getMessage() == "job job_1 failed: The arm has no flange: add one."


def _unreadable(folder: Path) -> sqlite3.Error:
    """What SQLite says of a file that is a folder: nobody can read it, root neither."""
    with pytest.raises(sqlite3.OperationalError) as raised:
        sqlite3.connect(folder)
    return raised.value
