"""The job engine on a SQLite that is older than the time stamps of its tables; a real worker runs."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

import httpx
import pytest
from sqlalchemy import make_url, text

from kilter_service.jobs.engine_clock import keep_time
from kilter_service.settings import Settings

OLD, NEW = "strftime('%s','now')", "unixepoch('subsec')"


def date_tables_as_python_3_12_does(path: str) -> int:
    """Give the engine's tables the defaults that DBOS writes with Python 3.12; returns how many have them then."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        connection.execute("UPDATE sqlite_master SET sql = replace(sql, ?, ?) WHERE type = 'table'", (OLD, NEW))
        connection.execute("PRAGMA writable_schema = RESET")
        connection.execute("DELETE FROM application_versions")  # what a first start writes
        found = connection.execute("SELECT count(*) FROM sqlite_master WHERE instr(sql, ?)", (NEW,)).fetchone()
    return int(found[0])


def test_a_worker_runs_on_tables_that_a_newer_sqlite_dates(
    client: httpx.Client, katana: Any, worker: Any, until: Callable[..., None], settings: Settings
) -> None:
    campaign = katana.campaign(client, 60)
    worker.start()  # makes the tables
    assert worker.stop() == 0
    path = make_url(settings.jobs_database)
    if path.get_backend_name() != "sqlite":
        pytest.skip("PostgreSQL dates its own rows")
    assert date_tables_as_python_3_12_does(str(path.database)) > 0
    before = time.time()
    worker.start()
    job = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    made = client.post("/v1/jobs", json=job).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{made}").json()["state"] in ("succeeded", "failed"), seconds=60)
    done = client.get(f"/v1/jobs/{made}").json()
    assert done["state"] == "succeeded", done
    assert worker.stop() == 0
    with closing(sqlite3.connect(str(path.database))) as connection:
        (stamp,) = connection.execute("SELECT version_timestamp FROM application_versions").fetchone()
    assert before * 1000 - 1 <= stamp <= time.time() * 1000 + 1


def test_connections_of_the_engine_know_milliseconds() -> None:
    from dbos._sys_db_sqlite import SQLiteSystemDatabase

    keep_time()
    keep_time()  # the API's client and the worker may share a process
    engine = SQLiteSystemDatabase._create_engine(object.__new__(SQLiteSystemDatabase), "sqlite://", {})
    before = time.time()
    with engine.connect() as connection:
        (seconds,) = connection.execute(text("SELECT unixepoch('subsec')")).one()
    engine.dispose()
    assert before - 0.001 <= seconds <= time.time() + 0.001
