"""While a database is migrated, however slow its disk is, the other processes of a server wait and do not open it."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kilter_service.ground.backup_folder import is_migrating, migration_lock
from kilter_service.ground.db import Database, revision
from kilter_service.ground.settings import Settings
from kilter_service.run.serving import MIGRATION_WAIT_S, check_database
from kilter_service.run.supervisor import SUPERVISED
from kilter_service.stream.corrector.active import DatabaseSource
from kilter_service.web import pulse
from tests.service.forked import ForkedPopen

COMMAND = [sys.executable, "-m", "kilter_service", "worker"]
REPOSITORY = pulse.__file__.partition("/service/")[0]


@pytest.fixture
def empty(settings: Settings) -> Settings:
    """A server that starts for the first time."""
    settings.data.mkdir(parents=True, exist_ok=True)
    return settings.model_copy(update={"database_url": None})


def migrate(settings: Settings) -> None:
    database = Database(settings.database)
    revision.migrate(database)
    database.close()


def test_the_lock_ends_with_its_holder(empty: Settings) -> None:
    assert not is_migrating(empty.data)
    with migration_lock(empty.data):
        assert is_migrating(empty.data)
    assert not is_migrating(empty.data)


def test_an_api_and_a_worker_wait_without_opening_the_database(empty: Settings) -> None:
    assert empty.sqlite_file is not None
    worker, supervised = None, {**os.environ, **empty.environment(), SUPERVISED: "1"}
    try:
        with ThreadPoolExecutor(1) as pool:
            with migration_lock(empty.data):
                waiting = pool.submit(check_database, empty, 1e-6)  # which a migration does not count for
                worker = ForkedPopen(COMMAND, env=supervised, cwd=REPOSITORY, stdin=subprocess.PIPE)
                with pytest.raises(subprocess.TimeoutExpired):
                    worker.wait(3)
                assert not waiting.done()
                assert not empty.sqlite_file.exists()
                migrate(empty)
            waiting.result(60)
        with pytest.raises(subprocess.TimeoutExpired):
            worker.wait(3)  # it takes jobs now
    finally:
        if worker is not None:
            worker.kill()
            worker.communicate(timeout=10)


def test_a_corrector_neither_waits_nor_complains(
    empty: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert empty.sqlite_file is not None
    monkeypatch.setattr(pulse, "BEAT_S", 0.05)
    source = DatabaseSource(empty.database, None, empty.data)
    with caplog.at_level(logging.WARNING):
        with migration_lock(empty.data), pulse.Pulse(empty, "corrector", "local"):
            assert source.stamp() is None
            assert source.load() == {}
        assert caplog.records == []
    migrate(empty)
    assert source.stamp() is not None
    source.close()


@pytest.mark.slow
def test_a_first_start_whose_migration_lasts_is_ready_and_complains_of_nothing(tmp_path: Path) -> None:
    """As on a slow disk: longer than any process of it waits for a database that another machine migrates."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    own = {"KILTER_DATA": str(tmp_path), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    with migration_lock(tmp_path):
        server = subprocess.Popen(
            [*COMMAND[:-1], "serve"], env=plain | own, cwd=REPOSITORY, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        with pytest.raises(subprocess.TimeoutExpired):
            server.wait(MIGRATION_WAIT_S + 5.0)
        assert not list(tmp_path.glob("*.db*"))
    try:
        assert server.stdout is not None
        assert '"url"' in server.stdout.readline()
    finally:
        server.terminate()
        _, said = server.communicate(timeout=60)
    assert "INFO kilter.serve: the database was brought to revision" in said
    assert [line for line in said.splitlines() if " INFO " not in line] == []
