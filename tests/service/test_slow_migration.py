"""While a database is migrated, however slow its disk is, the other processes of a server wait and do not open it."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from kilter_service.ground.db import Database, revision
from kilter_service.ground.files.migration_lock import is_migrating, migration_lock
from kilter_service.ground.settings import Settings
from kilter_service.run.serving import check_database
from kilter_service.run.supervisor import SUPERVISED
from kilter_service.stream.corrector.database_source import DatabaseSource
from kilter_service.web.health import pulse
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
